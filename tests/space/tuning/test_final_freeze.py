"""The statistics that a fine-tuned decoder is frozen with are those of its own code."""

import pytest
import torch
from tuning import CODE, CONFIG, scene, start

from matcap.space.freeze import freeze
from matcap.space.tuning import finetune


@pytest.fixture
def frozen(monkeypatch):
    """Codes that were frozen at, in turn; the statistics are the true ones."""
    codes = []

    def remember(decoder, code, *read):
        codes.append(code.clone())
        return freeze(decoder, code, *read)

    monkeypatch.setattr(finetune, "freeze", remember)
    return codes


def interrupt(*_):
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("steps", "report"),
    [(0, lambda *_: None), (3, lambda *_: None), (20, interrupt)],
    ids=["no steps", "frozen end", "interrupted before it"],
)
def test_what_is_frozen_is_frozen_at_the_code(frozen, steps, report):
    code = torch.linspace(-1.0, 1.0, len(CODE))
    decoder = start()
    with torch.no_grad():  # an untrained decoder hardly heeds its code
        for layer in decoder.layers():
            layer.adain.affine.weight.normal_(0.0, 0.1)
    asked = finetune.TuneSettings(steps=steps, half_precision=False)
    tuned = finetune.finetune(decoder, code, scene(), asked, report)
    assert frozen and all(torch.equal(one, code) for one in frozen)
    assert len(tuned.moments) == len(decoder.layers())
    expected = freeze(tuned.decoder, code, ())
    elsewhere = freeze(tuned.decoder, 0.0 * code, ())

    def apart(moments):
        pairs = zip(tuned.moments, moments, strict=True)
        return sum(float((a[1] - b[1]).abs().mean()) for a, b in pairs)

    assert apart(expected) < 0.5 * apart(elsewhere)
    assert tuned.decoder.config == CONFIG
