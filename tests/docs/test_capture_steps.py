"""examples/capture_steps.py: the public steps put together by hand are a capture."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from matcap.capture.pipeline import capture_photo
from matcap.capture.settings import CaptureSettings
from matcap.photo.load import load_photo

EXAMPLES = Path(__file__).parents[2] / "examples"
DETAIL = 128


@pytest.fixture
def steps(monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)
    return pytest.importorskip("capture_steps")


@pytest.mark.capture
@pytest.mark.usefixtures("one_coarse_fit")
def test_steps_by_hand_give_the_maps_of_a_capture_and_take_another_prior(steps):
    photo = load_photo(EXAMPLES / "photos" / "leather.dng", long_side=DETAIL)
    material, maps = steps.capture(photo)
    whole = capture_photo(photo, CaptureSettings(detail=DETAIL, generator="example")).material
    assert torch.equal(
        material.maps(64, 48, seed=3).stacked(), whole.maps(64, 48, seed=3).stacked()
    )

    flat, flat_maps = steps.capture(photo, steps.flat_prior)
    assert torch.isfinite(flat_maps.stacked()).all()
    assert flat_maps.height.std() < 0.5 * maps.height.std()  # relief is the prior's
