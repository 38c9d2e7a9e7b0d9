"""Refinement by re-rendering."""

from __future__ import annotations

import torch
from photographed import photographed

from matcap.capture.exemplar.refine import Light, level, refine
from matcap.model.inverse.inputs import true_outputs

ERRORS = torch.log(torch.tensor([0.2, 0.1, 0.1, 0.1]))[:, None, None]


def _setting(slope: float = 0.1, contrast: float = 0.1):
    shot = photographed(slope, contrast, width=192, height=144)
    valid = torch.ones(144, 192, dtype=torch.bool)
    return shot, valid, true_outputs(shot.maps, shot.uniform), ERRORS.expand(4, 144, 192)


def test_the_truth_is_left_alone() -> None:
    shot, valid, truth, errors = _setting()
    refined = refine(truth, errors, shot.linear, valid, Light(shot.uniform, shot.points))
    assert float(refined.residual.abs().median()) < 1e-3
    assert float((refined.outputs - truth).abs().max()) < 0.05


def test_a_flat_guess_is_moved_until_it_re_renders() -> None:
    shot, valid, truth, errors = _setting()
    guess = torch.zeros_like(truth)
    refined = refine(guess, errors, shot.linear, valid, Light(shot.uniform, shot.points))
    texture = refined.residual - refined.slow
    assert float(texture.abs().median()) < 0.01


def test_slow_drift_is_not_the_materials() -> None:
    shot, valid, truth, errors = _setting()
    drift = torch.linspace(-0.15, 0.15, 192).exp()
    refined = refine(truth, errors, shot.linear * drift, valid, Light(shot.uniform, shot.points))
    assert float((refined.outputs - truth)[:3].mean((0, 1)).diff().abs().mean()) < 1e-3
    assert float(refined.slow.abs().mean()) > 0.04


def test_clipped_texels_are_lower_bounds() -> None:
    """Brighter than the clip level is as good as at it; darker is not."""
    shot, valid, truth, errors = _setting()
    clip = float(shot.linear.quantile(0.7))
    clipped = shot.linear.clamp_max(clip)
    unclipped = (shot.linear < clip).all(0)
    refined = refine(truth, errors, clipped, unclipped, Light(shot.uniform, shot.points))
    assert float((refined.outputs - truth).abs().max()) < 0.05


def test_levels_are_found_again() -> None:
    shot, valid, truth, _ = _setting()
    off = truth.clone()
    off[:3] -= 0.3
    found = level(off, shot.linear, valid, Light(shot.uniform, shot.points))
    assert float((found - truth)[:3].mean().abs()) < 0.06


def test_relief_is_not_touched() -> None:
    shot, valid, truth, errors = _setting()
    guess = torch.zeros_like(truth)
    refined = refine(guess, errors, shot.linear, valid, Light(shot.uniform, shot.points))
    assert float(refined.outputs[5].abs().max()) == 0.0
