"""Lower precision is chosen where no eye can see it, and said."""

import pytest
import torch

from matcap.errors import MatcapError
from matcap.field.plane import Rectangle
from matcap.synth import precision
from matcap.synth.precision import choose

BLOCK = Rectangle(512, 256, 512, 256)


def test_fp32_is_the_source_itself(material):
    source = material.generator.source(1)
    assert choose(source, "fp32").source is source


def test_auto_stays_below_half_a_step_also_elsewhere(material, wavy):
    for one in (material, wavy):
        source = one.generator.source(1)
        chosen = choose(source, "auto")
        assert all(steps < 0.5 for steps in chosen.steps.values())
        exact, rough = source.maps(BLOCK), chosen.source.maps(BLOCK)
        # Of another block: the same but for chance.
        assert float((exact[3:5] - rough[3:5]).abs().max()) < 0.7 / 255
        assert ("bf16" in chosen.name) == (not torch.equal(exact, rough))


def test_auto_falls_back_when_the_error_would_be_seen(material, monkeypatch):
    monkeypatch.setattr(precision, "HALF_STEP", 1e-9)
    monkeypatch.setattr(precision, "multiplies_bfloat16", lambda _device: True)
    source = material.generator.source(1)
    chosen = choose(source, "auto")
    assert chosen.source is source and chosen.sentence() == "precision fp32"


def test_without_bfloat16_auto_is_fp32_and_bf16_an_error(material, monkeypatch):
    monkeypatch.setattr(precision, "multiplies_bfloat16", lambda _device: False)
    source = material.generator.source(1)
    assert choose(source, "auto").source is source
    with pytest.raises(MatcapError, match="bfloat16"):
        choose(source, "bf16")


def test_the_fused_steps_are_the_plain_ones(wavy, monkeypatch):
    from matcap.space import layers

    source = wavy.generator.source(1)
    fused = source.maps(BLOCK)
    monkeypatch.setattr(layers, "_fused", lambda _features: False)
    assert torch.allclose(source.maps(BLOCK), fused, atol=1e-5)
