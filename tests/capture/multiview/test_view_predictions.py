"""Predictions of each photograph, fused in the first one's frame."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from simulated.photographs import Hand, PhoneCamera, hold

from matcap.brdf.maps import MapSet
from matcap.brdf.parameters import F0
from matcap.capture.multiview.texels import Estimate, maps_of, parameters_of
from matcap.capture.multiview.view_predictions import OwnPlane, fused, resampled_over, with_others
from matcap.capture.multiview.views import SharedLight, ViewWarp
from matcap.capture.registration.camera import PosedCamera, grid_points
from matcap.flash.geometry import camera_in_plane

PHONE = PhoneCamera(width=640, height=480)
SIZE = (96, 128)
DOUBT = torch.full((4, *SIZE), -2.0)  # of log errors


@pytest.fixture(scope="module")
def cameras():
    return hold(PHONE, Hand(turned=0.2), 3, 4)


def _light():
    gain = torch.tensor([0.0, 0.3, 0.0])[:, None].expand(3, 3)
    return SharedLight(torch.tensor([0.04, -0.07]), torch.zeros(2), gain, torch.full((3,), 5.0))


@pytest.fixture(scope="module")
def brought(cameras):
    """The second photograph's plane, and a function that resamples its maps to the first's."""
    own = OwnPlane.of(cameras[1], _light(), 1)
    warp = ViewWarp(np.eye(3), np.zeros((1, 1), np.float32), cameras[0].place)

    def over(maps):
        log_error = torch.full((4, *maps.size[::-1]), -2.0)
        return resampled_over(Estimate(maps, log_error), own, cameras[1], warp, SIZE[::-1])[0]

    return own, over


def _waves(points, texel_size):
    """Maps whose albedo and height are functions of the first plane's points."""
    x, y = (torch.from_numpy(p).float() for p in points[:2])
    tone = 0.3 * (0.5 * torch.sin(6.0 * x) * torch.cos(5.0 * y)).exp()
    return MapSet(
        tone.expand(3, -1, -1).contiguous(),
        torch.full((1, *tone.shape), 0.04),
        (0.5 + 0.1 * torch.sin(4.0 * x + y))[None],
        0.03 * torch.sin(5.0 * x - 7.0 * y)[None],
        texel_size,
    )


def test_a_camera_on_its_own_plane_stands_where_it_does(cameras):
    own = OwnPlane.of(cameras[1], replace(_light(), centre=(0.1, 0.2)), 1)
    points = grid_points(16, 12)
    here = np.concatenate([own.coordinates(points), np.zeros((1, 12, 16))])
    seen = PosedCamera.of(own.setup).sees(here)
    np.testing.assert_allclose(seen, cameras[1].sees(points), atol=1e-9)
    assert own.setup.vignetting_centre == (0.1, 0.2)  # of image coordinates, which are the same
    # And so does its flash, as strong at its own distance.
    _, flash = camera_in_plane(own.setup)
    away = np.linalg.norm(flash.numpy() - here.reshape(3, -1).T, axis=1)
    place = cameras[1].flash((0.04, -0.07, 0.0))
    there = np.linalg.norm(place - points.reshape(3, -1).T, axis=1)
    irradiance = 5.0 * math.exp(0.3) / there**2
    np.testing.assert_allclose(own.setup.intensity[0] / away**2, irradiance, rtol=1e-6)


def test_a_reading_is_brought_over_the_first(cameras, brought):
    own, over = brought
    # The other plane's texels, as points of the first's.
    across, down = 256, 192
    theirs = PosedCamera.of(own.setup).sees(grid_points(across, down))
    maps = _waves(cameras[1].on_plane(theirs), 2.0 / across)
    read = over(replace(maps, height=maps.height / own.scale))
    true = parameters_of(_waves(grid_points(SIZE[1], SIZE[0]), 2.0 / SIZE[1]))
    known = (read.log_error[3] < -1.9)[None].expand_as(true)
    known = known & (torch.nn.functional.avg_pool2d(known.float(), 5, 1, 2) > 0.999)
    assert 0.4 < known.float().mean() < 1.0
    assert float((parameters_of(read.maps) - true)[known].abs().max()) < 0.03


def test_no_border_of_a_reading_is_seen(brought):
    theirs = brought[1](_waves(np.zeros((2, 192, 256)), 2.0 / 256))
    otherwise = _waves(np.zeros((2, *SIZE)), 2.0 / SIZE[1])
    otherwise = replace(otherwise, specular=math.e * otherwise.specular)
    both = parameters_of(fused([Estimate(otherwise, DOUBT), theirs]).maps)[F0]
    assert float(both.max() - both.min()) > 0.4
    steps = torch.cat([both.diff(dim=0).abs().flatten(), both.diff(dim=1).abs().flatten()])
    assert float(steps.max()) < 0.1


def _read(maps, off, generator, log_error):
    numbers = parameters_of(maps)
    noise = off * torch.randn(numbers.shape, generator=generator)
    noisy = maps_of(numbers + noise, maps.height, maps.texel_size)
    return Estimate(noisy, torch.full((4, *SIZE), log_error))


def test_joined_readings_are_nearer_in_any_order_and_the_doubtful_count_less():
    maps = _waves(grid_points(SIZE[1], SIZE[0]), 2.0 / SIZE[1])
    generator = torch.Generator().manual_seed(0)
    read = [_read(maps, 0.1, generator, math.log(0.1)) for _ in range(3)]
    wild = _read(maps, 3.0, generator, math.log(3.0))

    def off(readings):
        return float(
            (parameters_of(fused(readings).maps)[:5] - parameters_of(maps)[:5]).square().mean()
        )

    assert off(read) < 0.4 * off(read[:1])
    assert off([*read, wild]) < 1.1 * off(read)
    forth, back = fused(read).maps, fused(read[::-1]).maps
    torch.testing.assert_close(forth.stacked(), back.stacked(), atol=1e-4, rtol=0.0)
    # Three are surer than one, but not as if they erred each on their own.
    surer = float((fused(read).log_error - fused(read[:1]).log_error).mean())
    assert math.log(1.0 / math.sqrt(3.0)) < surer < -0.1


def test_alone_the_first_stays_as_it_was_read_and_others_leave_it_its_fine_waves():
    rng = torch.Generator().manual_seed(5)
    fine = tuple(2 * side for side in SIZE)
    maps = _waves(grid_points(fine[1], fine[0]), 2.0 / fine[1])
    maps = replace(maps, diffuse=maps.diffuse * (0.1 * torch.randn(3, *fine, generator=rng)).exp())
    log_error = torch.full((4, *fine), -2.0)
    small = MapSet.from_stacked(
        torch.nn.functional.avg_pool2d(maps.stacked()[None], 2)[0], 2.0 / SIZE[1]
    )
    first = Estimate(small, DOUBT)
    alone = Estimate(maps, log_error)
    same = with_others(alone, [first])
    torch.testing.assert_close(same.maps.stacked(), maps.stacked(), atol=1e-4, rtol=0.0)
    torch.testing.assert_close(same.log_error, log_error)
    darker = Estimate(replace(small, diffuse=math.exp(-0.4) * small.diffuse), DOUBT)
    both = with_others(alone, [first, darker])
    log = both.maps.diffuse.log()
    torch.testing.assert_close(log, maps.diffuse.log() - 0.2, atol=0.01, rtol=0.0)
    assert (both.log_error < log_error).all()
