"""Mosaics, and network predictions of each photograph."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from report_schema import check_report
from seen_views import photographed
from simulated.materials import piece
from simulated.photographs import Hand, PhoneCamera, hold, true_maps_along

from matcap.brdf.cook_torrance import F0
from matcap.brdf.folder import read_mapset
from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.estimate import map_set_of
from matcap.capture.multiview import mosaic as mosaic_module
from matcap.capture.multiview.mosaic import (
    LEAST,
    STEEPEST,
    Mosaic,
    OwnPlane,
    fused,
    mosaic_of,
    resampled_over,
    scatter,
    seen_by_any,
    sees,
    spread_over,
    unpredicted,
    with_others,
)
from matcap.capture.multiview.texels import SLOPES, Estimate, maps_of, parameters_of
from matcap.capture.multiview.views import SharedLight, ViewWarp
from matcap.capture.pipeline import capture_photo
from matcap.capture.rectified import UNION_TIMES
from matcap.capture.registration.camera import PosedCamera, grid_points
from matcap.capture.registration.register import RegisteredView
from matcap.capture.report import write_outputs
from matcap.capture.settings import CaptureSettings, OutputSettings
from matcap.cli.main import main
from matcap.field.opened import open_photographed
from matcap.flash.geometry import OWN, FlashSetup, Margins, camera_in_plane, plane_points
from matcap.photo.photo import Photo

# Extent of a mosaic, and predictions and maps over it.


PHONE = PhoneCamera(width=640, height=480, supersampling=1)
BESIDE = Hand(aside=math.tan(math.radians(PHONE.fov) / 2.0), aimed=1.0)
SIZE = (128, 96)


def _view(camera, flash=True):
    pixels = np.full((96, 128, 3), 0.5, np.float32)
    photo = Photo(
        pixels, np.zeros((96, 128), bool), PHONE.fov, "exif", True, "made", original_size=(128, 96)
    )
    return RegisteredView(photo, camera, flash=flash)


def _camera(x=0.0, y=0.0, tilt=(0.0, 0.0)):
    camera = PosedCamera.of(FlashSetup(fov=PHONE.fov, tilt=tilt))
    return replace(camera, place=camera.place + np.array([x, y, 0.0]))


def test_a_mosaic_keeps_the_texel_size_of_the_first_photograph():
    margins = Margins(left=3, right=40, top=5, bottom=0)
    width, height = margins.around(SIZE)
    assert (width, height) == (171, 101)
    points = grid_points(width, height, margins.extent(SIZE[0]))
    np.testing.assert_allclose(
        points[:, *margins.inside(SIZE)], grid_points(*SIZE), rtol=0.0, atol=1e-12
    )
    floats = plane_points(0, 0, width, height, (width, height), dtype=torch.float64)
    placed = margins.extent(SIZE[0]).placed(floats).numpy()
    np.testing.assert_allclose(placed, points, rtol=0.0, atol=1e-12)
    assert margins.own(SIZE).sum() == SIZE[0] * SIZE[1]
    assert margins.extent(SIZE[0]).unit(width) == pytest.approx(SIZE[0])
    assert Margins().extent(128) == OWN and not Margins().any


def test_two_photographs_side_by_side_reach_half_as_far_again():
    mosaic = mosaic_of([_view(_camera()), _view(_camera(x=1.0))], SIZE)
    assert (mosaic.margins.left, mosaic.margins.top, mosaic.margins.bottom) == (0, 0, 0)
    assert mosaic.margins.right == pytest.approx(64, abs=2)
    assert mosaic.times == pytest.approx(1.5, abs=0.02)
    assert mosaic.known > 0.98 and mosaic.covered > 0.98
    assert mosaic.warning() is None and "1.5 times" in mosaic.summary()
    # One that lights nothing reads nothing.
    assert not mosaic_of([_view(_camera()), _view(_camera(x=1.0), flash=False)], SIZE).margins.any


def test_texels_between_photographs_are_unknown():
    views = [_view(_camera()), _view(_camera(x=1.2)), _view(_camera(y=0.9))]
    mosaic = mosaic_of(views, SIZE)
    known = seen_by_any(views, mosaic)
    assert known.shape == mosaic.margins.around(SIZE)[::-1]
    assert not known[0, -1] and known[-1, -1] and known[0, 0]
    assert float(known.float().mean()) == pytest.approx(mosaic.known, abs=0.02)


def test_a_tilted_camera_extends_the_mosaic_as_far_as_it_sees_well():
    lean = math.radians(50.0)
    camera = PosedCamera.of(FlashSetup(fov=PHONE.fov, tilt=(0.0, lean)))
    mosaic = mosaic_of([_view(_camera()), _view(camera)], SIZE)
    points = grid_points(*mosaic.margins.around(SIZE), mosaic.extent)
    away = camera.place[:, None, None] - points
    seen = sees(camera, points, 0.75, STEEPEST)
    steep = np.degrees(np.arccos(away[2] / np.linalg.norm(away, axis=0)))
    assert steep[seen].max() <= STEEPEST
    assert sees(camera, points, 0.75, 89.0).sum() > seen.sum()
    # And no side of the box is hardly seen at all.
    known = seen_by_any([_view(_camera()), _view(camera)], mosaic).numpy()
    for side in (known[0], known[-1], known[:, 0], known[:, -1]):
        assert side.mean() > 0.9 * LEAST


def test_a_mosaic_is_limited_by_memory_with_a_note(monkeypatch):
    far = [_view(_camera())] + [_view(_camera(x=1.5 * n, y=1.1 * n)) for n in range(1, 5)]
    mosaic = mosaic_of(far, SIZE)
    assert mosaic.limited and mosaic.times <= UNION_TIMES
    assert "is left out of the maps" in mosaic.warning()
    monkeypatch.setattr(mosaic_module, "_TEXELS", 1.2 * SIZE[0] * SIZE[1])
    few = mosaic_of(far, SIZE)
    assert few.times <= 1.2 and few.covered < mosaic.covered


def _drawn(size, seed=0):
    generator = torch.Generator().manual_seed(seed)
    rows = torch.randn(6, *size[::-1], generator=generator)
    maps = [0.3 * (0.1 * rows[:3]).exp(), 0.04 * (0.1 * rows[3:4]).exp(), 0.5 + 0.02 * rows[4:5]]
    return MapSet(*maps, 0.002 * rows[5:], 2.0 / size[0])


def test_the_first_prediction_is_extended_smoothly_with_its_scatter_as_error():
    maps, log_error = _drawn(SIZE), torch.full((4, *SIZE[::-1]), -2.0)
    read = Estimate(maps, log_error)
    assert spread_over(read, Margins()) is read
    assert torch.equal(unpredicted(log_error, Mosaic.own(SIZE)), log_error)

    margins = Margins(right=64, bottom=20)
    spread = spread_over(read, margins)
    over, unsure = spread.maps, spread.log_error
    inside = margins.inside(SIZE)
    assert torch.equal(over.stacked()[:, *inside], maps.stacked())
    assert torch.equal(unsure[:, *inside], log_error)
    beyond = over.diffuse[:, :, SIZE[0] + 20 :]
    assert float(beyond.log().std()) < 0.5 * float(maps.diffuse.log().std())
    assert float(beyond.mean()) == pytest.approx(0.3, rel=0.1)
    torch.testing.assert_close(unsure[:, -1, -1], scatter(read))
    nowhere = unpredicted(unsure, Mosaic(margins, SIZE))
    assert (nowhere[:, :, SIZE[0] :] > 3.0).all() and torch.equal(nowhere[:, *inside], log_error)


def test_beyond_the_first_photograph_other_predictions_hold():
    margins = Margins(right=64)
    true = _drawn(margins.around(SIZE), 3)
    smooth = torch.nn.functional.avg_pool2d(true.stacked()[None], 5, 1, 2)[0]
    true = MapSet.from_stacked(smooth, 2.0 / SIZE[0])
    first = true.crop(0, 0, *SIZE)
    over = spread_over(Estimate(first, torch.full((4, *SIZE[::-1]), -3.0)), margins)
    unsure = unpredicted(over.log_error, Mosaic(margins, SIZE))
    over = replace(over, log_error=unsure)
    found = with_others(over, [over, Estimate(true, torch.full_like(unsure, -3.0))])
    off = (parameters_of(found.maps) - parameters_of(true))[:, 2:-2, 2:-2]
    assert float(off[: SLOPES.start].abs().max()) < 0.01
    # Slopes too, and without a step where the first one ends.
    steep = float(parameters_of(true)[SLOPES].square().mean().sqrt())
    assert float(off[SLOPES].square().mean().sqrt()) < 0.2 * steep
    assert float(off[SLOPES][..., SIZE[0] - 4 : SIZE[0] + 4].square().mean().sqrt()) < 0.4 * steep
    assert (found.log_error < -2.5).all()


def test_metal_beyond_the_first_photograph_has_the_colour_of_other_photographs():
    margins, gold = Margins(right=64), torch.tensor([1.3, 1.0, 0.7])[:, None, None]
    whole = margins.around(SIZE)[::-1]
    maps = _drawn(whole[::-1])
    other = replace(maps, specular=0.3 * gold.expand(3, *whole).contiguous())
    over = spread_over(
        Estimate(maps.crop(0, 0, *SIZE), torch.full((4, *SIZE[::-1]), -3.0)), margins
    )
    unsure = unpredicted(over.log_error, Mosaic(margins, SIZE))
    over = replace(over, log_error=unsure)
    found = with_others(over, [over, Estimate(other, torch.full_like(unsure, -3.0))]).maps.specular
    torch.testing.assert_close(found[..., SIZE[0] + 4 :], other.specular[..., SIZE[0] + 4 :])
    assert float((found[0] / found[2])[:, : SIZE[0] - 4].max()) < 1.5


@pytest.fixture(scope="module")
def captured():
    """(cameras, result) of two photographs, each of which shows half of the other."""
    cameras, photos = photographed("leather", PHONE, 2, 5, hand=BESIDE)
    settings = CaptureSettings(preset="instant", detail=192, union=True)
    return cameras, capture_photo(photos[0], settings, others=photos[1:])


def test_two_photographs_that_share_a_half_make_one_mosaic(captured):
    cameras, result = captured
    mosaic = result.estimate.several.mosaic
    assert 1.35 < mosaic.times < 1.75
    maps = map_set_of(result.estimate.exemplar)
    assert maps.size == mosaic.margins.around((192, 144))
    assert maps.texel_size == pytest.approx(2.0 / 192)
    assert result.estimate.first_rectangle.size == (192, 144)
    # What nobody saw is believed by nobody.
    known = seen_by_any(result.estimate.several.views, mosaic).numpy()
    trusted = result.estimate.exemplar.confidence
    assert (trusted[:, ~known] == 0.0).all() and trusted[0][known].mean() > 0.3

    other = result.estimate.several.views[1].camera
    points = grid_points(*maps.size, mosaic.extent)
    beyond = torch.from_numpy(sees(other, points, 0.75, STEEPEST))
    beyond &= ~mosaic.margins.own(mosaic.size)
    args = piece("leather"), PHONE, cameras, 1, other, maps.size, mosaic.extent
    true = true_maps_along(*args)
    slope, known = (maps.normal[:2].double() for maps in (maps, true))
    both = slope[:, beyond].norm() * known[:, beyond].norm()
    assert (slope * known)[:, beyond].sum() > 0.4 * both
    log, off = (one.diffuse.mean(0).log()[beyond] for one in (true, maps))
    off = off - log
    assert (off - off.median()).abs().mean() < 0.9 * (log - log.median()).abs().mean()


def test_a_union_is_written_and_reported(captured, tmp_path):
    _, result = captured
    result = replace(result, settings=replace(result.settings, aligned=True, preset="draft"))
    write_outputs(result, tmp_path / "leather", OutputSettings((32, 32)))
    check_report(tmp_path / "leather/report.json")
    values = json.loads((tmp_path / "leather/report.json").read_text())
    assert values["multi_view"]["mosaic"]["area_ratio"] == pytest.approx(
        result.estimate.several.mosaic.times
    )
    assert any("all that the photographs show" in note for note in values["notes"])
    assert values["settings"]["union"] is True
    assert values["effort"]["preset"] == "draft" and values["effort"]["steps"] == 0  # none was run
    assert not any("its rectangle" in warning for warning in values["warnings"])
    # Maps of all of the piece, whose middle is not the photograph's.
    piece, _ = read_mapset(tmp_path / "leather/leather_photo.json")
    assert piece.size == result.estimate.exemplar.size
    assert open_photographed(tmp_path / "leather/leather_photo.json") is None
    assert open_photographed(tmp_path / "leather/leather.matcap").size is None


def test_a_union_is_stored_only_where_given():
    assert "union" not in CaptureSettings().named()
    assert CaptureSettings.of(CaptureSettings(union=True).named()).union


def test_a_union_of_one_photograph_is_refused(tmp_path, capsys):
    photo = tmp_path / "a.jpg"
    photo.write_bytes(b"")
    for more in ([], ["--together"]):
        assert main(["capture", str(photo), "--union", *more, "-o", str(tmp_path / "out")]) == 2
        assert "give two or more of one sample" in capsys.readouterr().err


# Predictions of each photograph, fused in the first one's frame.


VIEW_PREDICTIONS_PHONE = PhoneCamera(width=640, height=480)
VIEW_PREDICTIONS_SIZE = (96, 128)
DOUBT = torch.full((4, *VIEW_PREDICTIONS_SIZE), -2.0)  # of log errors


@pytest.fixture(scope="module")
def cameras():
    return hold(VIEW_PREDICTIONS_PHONE, Hand(turned=0.2), 3, 4)


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
        return resampled_over(
            Estimate(maps, log_error), own, cameras[1], warp, VIEW_PREDICTIONS_SIZE[::-1]
        )

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


def test_a_camera_on_its_own_plane_projects_the_same_points(cameras):
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


def test_a_prediction_is_resampled_to_the_first_photograph(cameras, brought):
    own, over = brought
    # The other plane's texels, as points of the first's.
    across, down = 256, 192
    theirs = PosedCamera.of(own.setup).sees(grid_points(across, down))
    maps = _waves(cameras[1].on_plane(theirs), 2.0 / across)
    read = over(replace(maps, height=maps.height / own.scale))
    true = parameters_of(
        _waves(
            grid_points(VIEW_PREDICTIONS_SIZE[1], VIEW_PREDICTIONS_SIZE[0]),
            2.0 / VIEW_PREDICTIONS_SIZE[1],
        )
    )
    known = (read.log_error[3] < -1.9)[None].expand_as(true)
    known = known & (torch.nn.functional.avg_pool2d(known.float(), 5, 1, 2) > 0.999)
    assert 0.4 < known.float().mean() < 1.0
    assert float((parameters_of(read.maps) - true)[known].abs().max()) < 0.03


def test_borders_of_a_prediction_leave_no_step(brought):
    theirs = brought[1](_waves(np.zeros((2, 192, 256)), 2.0 / 256))
    otherwise = _waves(np.zeros((2, *VIEW_PREDICTIONS_SIZE)), 2.0 / VIEW_PREDICTIONS_SIZE[1])
    otherwise = replace(otherwise, specular=math.e * otherwise.specular)
    both = parameters_of(fused([Estimate(otherwise, DOUBT), theirs]).maps)[F0]
    assert float(both.max() - both.min()) > 0.4
    steps = torch.cat([both.diff(dim=0).abs().flatten(), both.diff(dim=1).abs().flatten()])
    assert float(steps.max()) < 0.1


def _read(maps, off, generator, log_error):
    numbers = parameters_of(maps)
    noise = off * torch.randn(numbers.shape, generator=generator)
    noisy = maps_of(numbers + noise, maps.height, maps.texel_size)
    return Estimate(noisy, torch.full((4, *VIEW_PREDICTIONS_SIZE), log_error))


def test_fused_predictions_are_nearer_in_any_order_and_weighted_by_error():
    maps = _waves(
        grid_points(VIEW_PREDICTIONS_SIZE[1], VIEW_PREDICTIONS_SIZE[0]),
        2.0 / VIEW_PREDICTIONS_SIZE[1],
    )
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


def test_other_predictions_leave_the_fine_waves_of_the_first():
    rng = torch.Generator().manual_seed(5)
    fine = tuple(2 * side for side in VIEW_PREDICTIONS_SIZE)
    maps = _waves(grid_points(fine[1], fine[0]), 2.0 / fine[1])
    maps = replace(maps, diffuse=maps.diffuse * (0.1 * torch.randn(3, *fine, generator=rng)).exp())
    log_error = torch.full((4, *fine), -2.0)
    small = MapSet.from_stacked(
        torch.nn.functional.avg_pool2d(maps.stacked()[None], 2)[0], 2.0 / VIEW_PREDICTIONS_SIZE[1]
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
