"""The finest bands come from the photograph, whatever the maps were read on."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F
from photographed import photographed, whole_plane

from matcap.brdf.heights import spline_enlarged
from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.detail_transfer import transfer_detail
from matcap.capture.exemplar.inpaint import Copies
from matcap.capture.exemplar.predict import map_set_of
from matcap.capture.rectified import PlaneLight, network_input
from matcap.capture.settings import DETAIL
from matcap.example.exemplar import Exemplar
from matcap.flash.light import render_flash
from matcap.flash.rectify import plane_of
from matcap.statistics.lattice import Wave


@pytest.fixture(scope="module")
def shot():
    """A photograph whose albedo has detail of single texels."""
    smooth = photographed(0.15, 0.1)
    detail = torch.from_numpy(np.random.default_rng(4).standard_normal((384, 512))).float()
    maps = replace(smooth.maps, diffuse=smooth.maps.diffuse * (0.15 * detail).exp())
    linear = render_flash(maps, smooth.uniform.setup, smooth.points)
    return replace(smooth, maps=maps, linear=linear)


def finest(log: torch.Tensor) -> float:
    """Standard deviation of the finest octave."""
    half = F.avg_pool2d(log[None], 2)
    return float((log - F.interpolate(half, scale_factor=2.0, mode="bicubic")[0]).std())


def _halved(maps: MapSet) -> Exemplar:
    half = maps.map(lambda m: F.avg_pool2d(m[None], 2)[0])
    certain = Exemplar.certain(half.stacked().numpy(), 2.0 * maps.texel_size)
    return replace(certain, confidence=0.8 * certain.confidence)


def test_the_exemplar_is_as_sharp_as_its_photograph(shot) -> None:
    plane = whole_plane(shot.linear)
    half = _halved(shot.maps)
    found = transfer_detail(half, plane, shot.uniform)
    assert found.size == plane.size and found.texel_size == plane.texel_size
    photographed = finest(shot.linear.log())
    rendered = PlaneLight(shot.uniform, plane.size).rendered(map_set_of(found))[0]
    assert finest(rendered) == pytest.approx(photographed, rel=0.1)
    enlarged = map_set_of(half).map(lambda m: F.interpolate(m[None], scale_factor=2.0)[0])
    blurred = replace(enlarged, texel_size=plane.texel_size)
    rendered = PlaneLight(shot.uniform, plane.size).rendered(blurred)[0]
    assert finest(rendered) < 0.5 * photographed


def test_grain_does_not_make_albedo_paler(shot) -> None:
    detail = torch.from_numpy(np.random.default_rng(5).standard_normal((384, 512))).float()
    maps = replace(shot.maps, diffuse=(0.15 * (0.6 * detail).exp()).expand(3, -1, -1))
    half = _halved(maps)
    linear = render_flash(maps, shot.uniform.setup, shot.points)
    found = transfer_detail(half, whole_plane(linear), shot.uniform)
    assert np.log(found.diffuse).std() > 1.3 * np.log(half.diffuse).std()
    assert found.diffuse.mean((1, 2)) == pytest.approx(half.diffuse.mean((1, 2)), rel=0.01)


def test_fine_grain_is_restored_and_coarse_albedo_kept(shot) -> None:
    half = _halved(shot.maps)
    found = map_set_of(transfer_detail(half, whole_plane(shot.linear), shot.uniform))
    fine, true = _fine(found), _fine(shot.maps)
    assert float(torch.corrcoef(torch.stack([fine, true]))[0, 1]) > 0.9
    coarse = F.avg_pool2d(found.diffuse[None], 4)[0] / F.avg_pool2d(shot.maps.diffuse[None], 4)[0]
    assert float(coarse.log().abs().mean()) < 0.03


def test_sensor_noise_is_not_taken_for_grain(shot) -> None:
    """Of a smooth albedo little is drawn, and what is drawn of detail is nearer to the truth."""
    rng = np.random.default_rng(5)
    true = _fine(shot.maps)
    smooth = replace(shot.maps, diffuse=torch.full_like(shot.maps.diffuse, 0.3))
    drawn = {}
    for name, maps in (("detail", shot.maps), ("smooth", smooth)):
        linear = render_flash(maps, shot.uniform.setup, shot.points)
        noisy, result = (
            0.15 * linear * torch.from_numpy(rng.standard_normal(linear.shape)).float()
            for _ in range(2)
        )
        plane = whole_plane((linear + noisy).clamp_min(0.0))
        for noise in (None, result):
            found = transfer_detail(_halved(maps), replace(plane, noise=noise), shot.uniform)
            drawn[name, noise is not None] = _fine(map_set_of(found))
    assert float(drawn["smooth", True].std() / drawn["smooth", False].std()) < 0.3
    off = [float((drawn["detail", result] - true).square().mean()) for result in (False, True)]
    assert off[1] < 0.9 * off[0]


def _fine(maps: MapSet) -> torch.Tensor:
    """What of log albedo half as many texels cannot hold."""
    log = maps.diffuse.log().mean(0)
    held = F.interpolate(F.avg_pool2d(log[None, None], 2), scale_factor=2.0)[0, 0]
    return (log - held).flatten()


def test_enlarged_heights_have_no_grid(shot) -> None:
    """Second differences modulo 4, of a height that is read on a quarter of the texels."""
    noise = np.random.default_rng(6).standard_normal((384, 512)).astype(np.float32)
    bumps = cv2.GaussianBlur(noise, (0, 0), 8.0)
    height = torch.from_numpy(3.0 * bumps / bumps.std())[None] * shot.maps.texel_size
    maps = replace(shot.maps, height=height)
    linear = render_flash(maps, shot.uniform.setup, shot.points)
    quarter = _halved(map_set_of(_halved(maps)))
    found = transfer_detail(quarter, whole_plane(linear), shot.uniform).height[0]
    for each in (found, found.T):
        curved = np.diff(each, 2, axis=1)
        grid = [np.sqrt(np.square(curved[:, k::4]).mean()) for k in range(4)]
        assert max(grid) < 1.1 * min(grid)


def test_splines_reproduce_quadratics() -> None:
    y, x = np.mgrid[0.0:48.0, 0.0:64.0]
    fine_y, fine_x = np.mgrid[0.0:144.0, 0.0:256.0]
    fine_y, fine_x = (fine_y + 0.5) / 3.0 - 0.5, (fine_x + 0.5) / 4.0 - 0.5

    def quadratic(x, y):
        return (0.5 + 0.2 * x - 0.1 * y + 0.01 * x * x - 0.02 * x * y + 0.005 * y * y).astype("f4")

    enlarged = spline_enlarged(quadratic(x, y), (256, 144))
    inside = slice(40, -40), slice(52, -52)
    assert enlarged[inside] == pytest.approx(quadratic(fine_x, fine_y)[inside], abs=1e-4)


def test_flat_maps_stay_flat(shot) -> None:
    """Grain of albedo over no relief is not drawn as relief."""
    half = replace(_halved(shot.maps), height=np.zeros((1, 192, 256), np.float32))
    found = transfer_detail(half, whole_plane(shot.linear), shot.uniform)
    assert float(np.abs(found.height).max()) < 1e-6


def test_clipped_texels_are_not_darkened(shot) -> None:
    clip = float(shot.linear.quantile(0.9))
    clipped = shot.linear.clamp_max(clip)
    measured = shot.linear < clip
    plane = replace(plane_of(clipped, measured.all(0)), channels=measured)
    found = map_set_of(transfer_detail(_halved(shot.maps), plane, shot.uniform))
    assert float((found.diffuse / shot.maps.diffuse)[~measured].log().mean()) > -0.1


def test_what_is_copied_from_elsewhere_has_the_detail_of_there(shot) -> None:
    """Under a clipped highlight no detail is seen; blocks are copied there."""
    hole, free = (slice(120, 240), slice(160, 360)), np.zeros((192, 256), np.bool_)
    free[60:120, 80:180] = True
    source = np.indices(free.shape)
    source[1, free] += 70
    measured = torch.ones(384, 512, dtype=torch.bool)
    measured[hole] = False
    linear = torch.where(measured, shot.linear, 0.9 * float(shot.linear.min()))
    plane = replace(plane_of(linear, measured), channels=measured.expand(3, -1, -1))
    found = transfer_detail(_halved(shot.maps), plane, shot.uniform, Copies(source, free)).diffuse
    whole = transfer_detail(_halved(shot.maps), whole_plane(shot.linear), shot.uniform).diffuse
    fine = [
        np.log(each) - cv2.GaussianBlur(np.log(each), (0, 0), 2.0) for each in (found[0], whole[0])
    ]
    drawn, true = fine[0][hole], fine[1][120:240, 300:500]
    assert float(np.corrcoef(drawn.ravel(), true.ravel())[0, 1]) > 0.6


def test_coarse_textures_are_predicted_at_half_resolution_and_lattices_at_full() -> None:
    y, x = torch.meshgrid(torch.arange(768.0), torch.arange(float(DETAIL)), indexing="ij")
    wide = 0.2 * (0.5 * torch.sin(x / 20.0) * torch.sin(y / 20.0)).exp().expand(3, -1, -1)
    plane = whole_plane(wide.contiguous())
    assert network_input(plane).size == (DETAIL // 2, 384)
    assert network_input(plane, (Wave(0.05, 0.0),)) is plane
