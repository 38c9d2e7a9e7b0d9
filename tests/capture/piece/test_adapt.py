"""Adaptation: levels and strengths found from windows at other places."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from photographed import photographed

from matcap.capture.method import FEATURES
from matcap.capture.piece.adapt import FitStage, adapt, corners
from matcap.flash.likeness import PhotographTarget
from matcap.flash.plane import plane_of
from matcap.flash.windows import cut_windows
from matcap.statistics.filterbank import FilterBank

SEEN = np.ones((384, 512), bool)


@pytest.fixture(scope="module")
def shot():
    return photographed(0.3, 0.15)


@pytest.fixture(scope="module")
def scene(shot):
    plane = plane_of(shot.linear, shot.linear.amax(0) < 0.98)
    bank = FilterBank(FEATURES)
    windows = cut_windows(plane, bank, 96)
    return PhotographTarget(
        windows, shot.uniform.setup, plane.encoding, bank, (), shot.maps.texel_size
    )


def _slope(maps) -> float:
    normal = maps.normal
    return float((normal[:2] / normal[2:]).square().mean().sqrt())


def test_relief_and_albedo_that_are_off_come_back(shot, scene) -> None:
    true = shot.maps
    off = replace(true, diffuse=true.diffuse * 0.8, height=true.height * 0.6)
    found = adapt(off, SEEN, scene, FitStage(30)).maps
    assert _slope(off) < 0.7 * _slope(true)
    assert _slope(found) == pytest.approx(_slope(true), rel=0.2)
    assert float(found.diffuse.mean()) == pytest.approx(float(true.diffuse.mean()), rel=0.08)
    drawn = torch.stack([found.height.flatten(), true.height.flatten()])
    assert float(torch.corrcoef(drawn)[0, 1]) > 0.97


def test_no_steps_change_nothing_and_the_same_seed_gives_the_same_maps(shot, scene) -> None:
    assert adapt(shot.maps, SEEN, scene, FitStage(0)).maps is shot.maps
    first, again = (
        adapt(shot.maps, SEEN, scene, FitStage(2, seed=3)).maps.stacked() for _ in range(2)
    )
    assert torch.equal(first, again)


def test_windows_lie_where_the_piece_was_seen() -> None:
    seen = SEEN.copy()
    seen[:, :256] = False
    found = corners(seen, 96)
    assert len(found) > 100
    assert found[:, 1].min() >= 256 - 0.05 * 96
    assert found.min() >= 0 and (found.max(0) + 96 == seen.shape).all()
    assert len(corners(np.zeros_like(seen), 96))  # there is always somewhere to look


def test_an_interrupt_keeps_what_was_found(shot, scene) -> None:
    def interrupt(share: float) -> None:
        if share > 0.1:
            raise KeyboardInterrupt

    found = adapt(shot.maps, SEEN, scene, FitStage(12, on_progress=interrupt))
    assert found.interrupted
    assert bool(torch.isfinite(found.maps.stacked()).all())


def test_time_ends_it(shot, scene) -> None:
    shares: list[float] = []
    adapt(shot.maps, SEEN, scene, FitStage(10_000, seconds=0.2, on_progress=shares.append))
    assert 1 <= len(shares) < 100


def test_windows_of_several_photographs_are_lit_by_their_own_flash(shot, scene) -> None:
    def found(flash):
        both = replace(scene.windows, photographs=torch.arange(scene.windows.count) % 2)
        joint = replace(scene, windows=both, others=(flash,))
        return adapt(shot.maps, SEEN, joint, FitStage(3)).change

    alone = adapt(shot.maps, SEEN, scene, FitStage(3)).change
    assert found(scene.setup) == alone
    assert found(scene.setup.with_intensity((1.0,) * 3)).before > 1.1 * alone.before


def test_what_is_not_nearer_on_windows_held_back_is_not_taken(shot, scene) -> None:
    """The truth cannot be bettered but by chance; maps that are off can."""
    found = adapt(shot.maps, SEEN, scene, FitStage(4))
    assert found.change.kept == (found.change.after < found.change.before)
    assert found.change.kept or torch.equal(found.maps.stacked(), shot.maps.stacked())
    dark = replace(shot.maps, diffuse=0.5 * shot.maps.diffuse)
    found = adapt(dark, SEEN, scene, FitStage(20))
    assert found.change.kept and found.change.albedo > 0.0


def test_without_time_maps_stay_as_they_are(shot, scene) -> None:
    found = adapt(shot.maps, SEEN, scene, FitStage(20, seconds=0.0))
    assert not found.interrupted and torch.equal(found.maps.stacked(), shot.maps.stacked())


def test_relief_that_is_told_stands(shot, scene) -> None:
    weak = replace(shot.maps, height=0.5 * shot.maps.height)
    free = adapt(weak, SEEN, scene, FitStage(20)).change.relief
    result = adapt(weak, SEEN, scene, FitStage(20, deviation=(0.01,) * 6)).change.relief
    assert abs(math.log(result)) < 0.5 * abs(math.log(free))
