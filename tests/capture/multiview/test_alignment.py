"""Registration by rendering: misregistered photographs move, certain ones stay."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from seen_views import LOG_ERROR, PHONE, SIZE, flattened, grainy, seen

from matcap.brdf.maps import MapSet
from matcap.capture.multiview import align
from matcap.capture.multiview.align import Aligned, aligned
from matcap.capture.multiview.shared import shared_step
from matcap.capture.multiview.solve import solve
from matcap.capture.multiview.texels import Estimate, ParameterPrior, parameters_of
from matcap.capture.multiview.views import RAW_FALLOFF
from matcap.capture.registration.register import register
from matcap.flash.geometry import FlashSetup

RIBS = 4.7  # texels


def _woven(astray=0.0, size=SIZE):
    """A flat weave, shifted by `astray` texels to the right."""
    texel = 2.0 / size[1]
    x, y = torch.arange(size[1]) - astray, torch.arange(size[0])[:, None]
    threads = torch.sin(2.0 * torch.pi * x / RIBS) + torch.sin(2.0 * torch.pi * y / RIBS)
    return MapSet(
        diffuse=(0.2 * (0.2 * threads).exp()).float().expand(3, -1, -1).contiguous(),
        specular=torch.full((1, *size), 0.04),
        roughness=torch.full((1, *size), 0.6),
        height=torch.zeros(1, *size),
        texel_size=texel,
    )


@pytest.fixture(scope="module")
def moved():
    """Texels by which each of five photographs is moved, if the fourth is 0.4 texels off."""
    views, light = seen([_woven(), _woven(), _woven(), _woven(0.4), _woven()])
    flat = flattened(_woven())
    log_error = LOG_ERROR.expand(4, *SIZE)
    light = replace(light, vignetting_deviation=RAW_FALLOFF)
    read = Estimate(flat, log_error)
    found = solve(views, read, light)

    def by(held):
        prior = ParameterPrior.of(read)
        free = set(range(5)).difference(held)
        numbers = parameters_of(found.maps)
        _, moves = shared_step(views, numbers, prior, found.light, moved=free)
        return [float(move[0, 2]) / flat.texel_size for move in moves]

    return by


def test_threads_of_five_texels_are_moved_as_far_as_they_lie_astray_and_no_farther(moved):
    """Twice as far, and photographs go to and fro for ever."""
    texels = moved(())
    assert 0.3 < texels[3] < 0.5
    assert max(abs(texels[k]) for k in (1, 2, 4)) < 0.15


def test_a_photograph_that_is_held_stays_and_others_move(moved):
    texels = moved((0, 2, 3))
    assert abs(texels[3]) < 1e-6 and abs(texels[2]) < 1e-6
    assert abs(texels[1]) > 0.05


@pytest.fixture(scope="module")
def laid(held):
    """Photographs of plaster before and after alignment, with a misregistration by features."""
    _, photos = held
    found = register(photos, FlashSetup(fov=PHONE.fov))
    maps = flattened(grainy(0, (96, 128)))
    setup = found.setup.with_intensity((5.0, 5.0, 5.0))
    log_error = LOG_ERROR.expand(4, 96, 128)

    def over(astray):
        views = tuple(replace(view, misregistration=astray) for view in found.views)
        lines = []
        begun = Aligned.of((found.views[0], *views[1:]), setup)
        by = aligned(begun, Estimate(maps, log_error), on_progress=lines.append)
        return found, by, len(lines)

    return over


def test_photographs_whose_features_are_sure_stay_and_relief_is_known(laid):
    found, by, grids = laid(1e-4)
    assert grids == 2  # the finest tells nothing more of relief
    for before, after in zip(found.views, by.views, strict=True):
        assert (before.camera.place == after.camera.place).all()
        assert before.position_deviation == after.position_deviation
    assert np.ptp(by.relief) > 0.0


def test_photographs_whose_features_are_not_sure_are_moved_until_they_hardly_move(
    laid, monkeypatch
):
    for name, value in (("LEVELS", (0.5, 1.0)), ("ROUNDS", (3, 3)), ("STEPS", (1, 0))):
        monkeypatch.setattr(align, f"_{name}", value)
    monkeypatch.setattr(align, "_SETTLED", 0.0)
    found, by, every = laid(1.0)
    assert every == 6
    for before, after in zip(found.views[1:], by.views[1:], strict=True):
        assert (before.camera.place != after.camera.place).any()
        assert after.position_deviation == align._REMAINING * before.position_deviation
    monkeypatch.setattr(align, "_SETTLED", 100.0)
    _, _, settled = laid(1.0)
    assert settled == 2
