"""What synthesis is measured beside: the paper's form is the network, and every step is counted."""

import pytest
import torch

from matcap.field.plane import Rectangle
from matcap.lab.bench import synth
from matcap.lab.bench.synth import SynthSettings, efficiency, paper_form, synth_experiment
from matcap.lab.experiment.runner import run
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
def test_a_short_run_fills_the_table(tmp_path, monkeypatch):
    settings = SynthSettings((64, 32), ("shipped",), ("64x32",), (1,), 1, (120, 96))
    experiment = synth_experiment(settings)
    rows = run(experiment, tmp_path / "synth.csv")
    assert torch.get_num_threads() == 2
    of_network = [row for row in rows if row.subject == "shipped"]
    assert len(rows) == len(experiment.configurations)
    assert {row.group for row in of_network} == {"as it comes", "kept", "convolutions"}
    for row in of_network:
        if row.group == "convolutions":
            assert row.number("share") == pytest.approx(
                row.number("GMAC") / row.number("GMAC plain"), rel=1e-4
            )
        else:
            paper, seconds = row.number("paper"), row.number("seconds")
            assert row.number("ratio") == pytest.approx(paper / seconds, rel=1e-3)
    assert rows[-1].configuration == "180x180, 1 workers" and rows[-1].number("a megatexel") > 0.0


def test_counted_multiplications_are_those_of_the_network(material):
    """By hand: one level-0 convolution of the head, 2 channels to 6, on the block and its ring."""
    from matcap.field.plane import Rectangle
    from matcap.space.source import spans_of_block

    tuned = material.part(TunedDecoder)
    decoder = tuned.source(0).decoder
    found = list(synth._convolutions(decoder, spans_of_block(Rectangle(0, 0, 64, 32), (1, 1))))
    assert [tuple(t.shape) for t in found[0]] == [(1, 2, 34, 66), (6, 2, 1, 1)]
    assert len(found) == 1 + 5 + 4 * 2
    assert efficiency(tuned, "fp32", 1)["GMAC"] > 0.0
