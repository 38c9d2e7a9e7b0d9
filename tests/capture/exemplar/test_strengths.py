"""Relief's and albedo's strength in closed form, against simulated truth."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from photographed import photographed

from matcap.capture.exemplar.strengths import BANDS, measure_strengths, slope_strengths
from matcap.model.inverse.inputs import network_inputs


def _measured(slope: float, contrast: float, **kwargs: int):
    shot = photographed(slope, contrast, width=1024, height=768, **kwargs)
    valid = torch.ones(shot.linear.shape[-2:], dtype=torch.bool)
    inputs = network_inputs(shot.linear, valid, shot.uniform, shot.points).numpy()
    found = measure_strengths(inputs[:3].mean(0), inputs[6:8], valid.numpy())
    assert found is not None
    true = slope_strengths((shot.maps.height / shot.maps.texel_size)[0].numpy())
    return found, true


@pytest.mark.parametrize("slope", [0.1, 0.3])
def test_slopes_are_found_as_strong_as_they_are(slope: float) -> None:
    found, true = _measured(slope, 0.03)
    whole = np.sqrt(np.square(true).sum())
    assert found.relief == pytest.approx(whole, rel=0.2)
    # And in the band that holds most of them.
    band = int(np.square(true).sum(1).argmax())
    here = np.sqrt(np.square(found.slope[band]).sum() / np.square(true[band]).sum())
    assert 0.8 < here < 1.25
    assert found.trust[band].mean() > 0.8
    told = found.document()
    assert sum(b["slope"] ** 2 for b in told["bands"]) == pytest.approx(told["relief"] ** 2)
    assert [tuple(b["waves"]) for b in told["bands"]] == list(BANDS)
    assert f"slope {found.relief:.2f}" in dict(found.lines())["relief"]


def test_albedo_alone_is_not_taken_for_relief() -> None:
    found, _ = _measured(1e-4, 0.3)
    assert np.sqrt(np.square(found.albedo).sum()) == pytest.approx(0.3, rel=0.35)
    relief = float(np.sqrt((found.trust * np.square(found.slope)).sum()))
    assert relief < 0.3  # 0.3 of log albedo would be slopes of 1 where the light slants by 0.3


def test_one_band_of_energy_stays_in_its_band() -> None:
    x = np.arange(512)
    wave = np.sin(2.0 * np.pi * x / 12.0)[None].repeat(384, 0).astype(np.float32)
    strengths = np.square(slope_strengths(wave)).sum(1)
    band = next(i for i, (longest, shortest) in enumerate(BANDS) if shortest < 12.0 <= longest)
    assert strengths[band] > 0.95 * strengths.sum()


def test_too_little_to_look_at_says_nothing() -> None:
    nothing = np.zeros((256, 256), np.float32)
    shows = np.zeros((2, 256, 256), np.float32)
    assert measure_strengths(nothing, shows, np.zeros((256, 256), bool)) is None
    assert measure_strengths(nothing[:64], shows[:, :64], np.ones((64, 256), bool)) is None
