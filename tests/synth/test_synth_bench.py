"""The benchmark's yardsticks: the paper's form is the network, and every step is counted."""

import csv
import io

import pytest
import torch

from matcap.field.plane import Rectangle
from matcap.lab.bench import synth
from matcap.lab.bench.synth import Settings, comma_separated, efficiency, markdown, paper_form
from matcap.space.decoder import PAPER_CONFIG, Decoder
from matcap.space.noise import noise_field
from matcap.space.patch import Patch
from matcap.space.tuned import TunedDecoder


def test_the_papers_network_has_its_size():
    decoder = Decoder(PAPER_CONFIG)
    weights = [layer.convolution.weight for layer in decoder.layers()]
    skipped = 4 * 9 * 12  # weights of waves, per channel of the four levels on the way up
    waves = sum(skipped // 4 * width for width in PAPER_CONFIG.widths[:-1])
    count = sum(w.numel() for w in weights) - waves
    affine = sum(p.numel() for p in decoder.parameters()) - sum(w.numel() for w in weights)
    assert 2.0e6 < count + affine < 3.0e6


def test_the_papers_form_is_the_decoder_but_for_the_blur(material, monkeypatch):
    monkeypatch.setattr(synth, "_blurred", lambda features: features)
    noise = noise_field(Patch(1, Rectangle(0, 0, 96, 64)), 2)[None]
    from matcap.space.random_field import random_field

    field = random_field(Patch(1, Rectangle(0, 0, 96, 64), period=(96, 64)), 2, (), levels=4)
    with torch.no_grad():
        tuned = material.part(TunedDecoder)
        found = paper_form(tuned.decoder, tuned.code, noise.contiguous())
        expected = tuned.decoder(field, tuned.code)
    # Its upsampling does not know that the field is periodic: only the inside is alike.
    inner = (..., slice(24, 40), slice(24, 72))
    assert float((found - expected)[inner].abs().mean()) < 0.3 * float(expected.std())


@pytest.mark.usefixtures("two_threads")
def test_a_short_run_fills_the_tables():
    settings = Settings((64, 32), ("shipped",), ("64x32",), (1,), 1, (120, 96))
    said = []
    report = synth.run_synth(settings, said.append)
    assert torch.get_num_threads() == 2
    precisions = len(report.efficiencies)
    assert {row.allocator for row in report.rows} == {"as it comes", "kept"}
    assert len(report.rows) == 2 * precisions and len(said) == 3 * precisions
    for row in csv.DictReader(io.StringIO(comma_separated(report))):
        seconds, paper = float(row["seconds"]), float(row["paper_seconds"])
        assert float(row["ratio"]) == pytest.approx(paper / seconds)
    assert "matcap bench synth" in markdown(report, "matcap bench synth")
    assert [one.step.split(",")[0] for one in report.examples][-1] == "180x180"
    assert all(one.processor_seconds > 0 for one in report.examples if one.megatexels)


def test_counted_multiplications_are_those_of_the_network(material):
    """By hand: one level-0 convolution of the head, 2 channels to 6, on the block and its ring."""
    from matcap.field.plane import Rectangle
    from matcap.space.source import spans_of_block

    tuned = material.part(TunedDecoder)
    decoder = tuned.source(0).decoder
    found = list(synth._convolutions(decoder, spans_of_block(Rectangle(0, 0, 64, 32), (1, 1))))
    assert [tuple(t.shape) for t in found[0]] == [(1, 2, 34, 66), (6, 2, 1, 1)]
    assert len(found) == 1 + 5 + 4 * 2
    one = efficiency("tiny", tuned, "fp32", 1)
    assert one.field > 0 and one.share == one.field / one.plain
