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

from matcap.brdf.folder import read_mapset
from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.predict import map_set_of
from matcap.capture.multiview import mosaic as mosaic_module
from matcap.capture.multiview.align import Aligned
from matcap.capture.multiview.mosaic import (
    LEAST,
    STEEPEST,
    mosaic_of,
    own_plane,
    predicted_beyond,
    resampled,
    seen_by_any,
    spread_over,
)
from matcap.capture.multiview.texels import SLOPES, Estimate, parameters_of
from matcap.capture.multiview.views import SharedLight
from matcap.capture.pipeline import capture_photo
from matcap.capture.registration.camera import PosedCamera, grid_points
from matcap.capture.registration.register import RegisteredView
from matcap.capture.report import write_outputs
from matcap.capture.settings import UNION_TIMES, CaptureSettings, OutputSettings
from matcap.cli.main import main
from matcap.field.opened import open_photographed
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.geometry import OWN, FlashSetup, Margins, camera_in_plane, plane_points
from matcap.photo.photo import Photo

# Extent of a mosaic, and predictions and maps over it.


PHONE = PhoneCamera(width=480, height=360, supersampling=1)
BESIDE = Hand(aside=math.tan(math.radians(PHONE.fov) / 2.0), aimed=1.0)
SIZE = (128, 96)


def _view(camera, flash=True):
    pixels = np.full((96, 128, 3), 0.5, np.float32)
    none = np.zeros((96, 128), bool)
    photo = Photo(pixels, none, PHONE.fov, "exif", True, "made", original_size=(128, 96))
    return RegisteredView(photo, camera, flash=flash)


def _camera(x=0.0, y=0.0, tilt=(0.0, 0.0)):
    camera = PosedCamera.of(FlashSetup(fov=PHONE.fov, tilt=tilt))
    return replace(camera, place=camera.place + np.array([x, y, 0.0]))


def test_a_mosaic_keeps_the_texel_size_of_the_first_photograph():
    margins = Margins(left=3, right=40, top=5, bottom=0)
    width, height = margins.around(SIZE)
    assert (width, height) == (171, 101)
    points = grid_points(width, height, margins.extent(SIZE[0]))
    inside = points[:, *margins.inside(SIZE)]
    np.testing.assert_allclose(inside, grid_points(*SIZE), rtol=0.0, atol=1e-12)
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
    camera = PosedCamera.of(FlashSetup(fov=PHONE.fov, tilt=(0.0, math.radians(50.0))))
    mosaic = mosaic_of([_view(_camera()), _view(camera)], SIZE)
    points = grid_points(*mosaic.margins.around(SIZE), mosaic.extent)
    away = camera.place[:, None, None] - points
    seen = camera.shows(points, 0.75, STEEPEST)
    steep = np.degrees(np.arccos(away[2] / np.linalg.norm(away, axis=0)))
    assert steep[seen].max() <= STEEPEST and camera.shows(points, 0.75, 89.0).sum() > seen.sum()
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
    rows = torch.randn(6, *size[::-1], generator=torch.Generator().manual_seed(seed))
    maps = [0.3 * (0.1 * rows[:3]).exp(), 0.04 * (0.1 * rows[3:4]).exp(), 0.5 + 0.02 * rows[4:5]]
    return MapSet(*maps, 0.002 * rows[5:], 2.0 / size[0])


def test_the_first_prediction_is_extended_smoothly_with_its_scatter_as_error():
    maps, log_error = _drawn(SIZE), torch.full((4, *SIZE[::-1]), -2.0)
    read = Estimate(maps, log_error)
    assert spread_over(read, Margins()) is read
    margins = Margins(right=64, bottom=20)
    spread = spread_over(read, margins)
    over, unsure = spread.maps, spread.log_error
    inside = margins.inside(SIZE)
    assert torch.equal(over.stacked()[:, *inside], maps.stacked())
    assert torch.equal(unsure[:, *inside], log_error)
    beyond = over.diffuse[:, :, SIZE[0] + 20 :]
    assert float(beyond.log().std()) < 0.5 * float(maps.diffuse.log().std())
    assert float(beyond.mean()) == pytest.approx(0.3, rel=0.1)
    albedo = parameters_of(maps)[:3].mean(0)
    assert float(unsure[0, -1, -1]) == pytest.approx(0.5 * math.log(albedo.var() + math.exp(-4.0)))


def _beyond(prediction, reach=0.5, at=0.0):
    """The mosaic of a flat first photograph, and what another's prediction makes beyond it.

    The other looks straight down from `reach` to the right; `prediction` is made of its plane.
    """
    first, other = _view(_camera(x=at)), _view(_camera(x=at + reach))
    mosaic = mosaic_of([first, other], SIZE)
    setup = FlashSetup(fov=PHONE.fov)
    alignment = Aligned.of((first, other), setup, mosaic.extent)
    flat = replace(_drawn(SIZE), diffuse=torch.full((3, *SIZE[::-1]), 0.3))
    flat = replace(flat, height=torch.zeros(1, *SIZE[::-1]))
    spread = spread_over(Estimate(flat, torch.full((4, *SIZE[::-1]), -2.0)), mosaic.margins)
    coarse = CoarseFit((0.3,) * 3, 0.04, 0.5, setup, 0.0)
    return mosaic, flat, predicted_beyond(alignment, spread, mosaic, coarse, prediction)


def _gold(plane, _fit):
    """A darker, coloured metal of known relief, seen from its own plane."""
    width, height = plane.size
    points = grid_points(width, height)
    one = torch.ones(1, height, width)
    wave = torch.from_numpy(0.01 * np.sin(9.0 * points[0])).float()[None]
    gold = 0.3 * torch.tensor([1.3, 1.0, 0.7])[:, None, None] * one
    maps = MapSet(0.1 * one.expand(3, -1, -1), gold, 0.4 * one, wave, 2.0 / width)
    return Estimate(maps, torch.full((4, height, width), -3.0))


def test_beyond_the_first_photograph_other_predictions_hold():
    mosaic, flat, found = _beyond(_gold)
    first, parameters = SIZE[0], parameters_of(found.maps)
    # What the other shows reaches to 0.5 beyond the first, less its border.
    there = slice(first + 4, first + 20)
    np.testing.assert_allclose(found.maps.diffuse[:, 16:-16, there], 0.1, rtol=0.02)
    assert float((found.maps.specular[0] / found.maps.specular[2])[16:-16, there].min()) > 1.8
    assert (found.log_error[:, 16:-16, there] < -2.9).all()
    points = grid_points(*mosaic.margins.around(SIZE), mosaic.extent)
    steep = torch.from_numpy(0.09 * np.cos(9.0 * (points[0] - 0.5))).float()
    off = (parameters[SLOPES][0] - steep)[16:-16, there]
    assert float(off.square().mean().sqrt()) < 0.2 * float(steep.square().mean().sqrt())


def test_within_the_first_photograph_its_own_prediction_holds():
    _, flat, found = _beyond(_gold)
    own = (..., slice(20, -20), slice(20, SIZE[0] - 20))
    torch.testing.assert_close(found.maps.diffuse[own], flat.diffuse[own], rtol=1e-4, atol=0.0)
    torch.testing.assert_close(found.maps.roughness[own], flat.roughness[own], rtol=1e-4, atol=1e-5)


def test_predictions_join_without_a_step():
    _, _, found = _beyond(_gold)
    log = found.maps.diffuse[0].log()
    assert float(log.max() - log.min()) > 1.0
    joined = log[8:-8, : SIZE[0] + 16]  # the outermost border is of one alone
    assert float(joined.diff(dim=1).abs().max()) < 0.2


@pytest.fixture(scope="module")
def captured():
    """(cameras, result) of two photographs, each of which shows half of the other."""
    cameras, photos = photographed("leather", PHONE, 2, 5, hand=BESIDE)
    settings = CaptureSettings(preset="instant", detail=128, union=True)
    return cameras, capture_photo(photos[0], settings, others=photos[1:])


def test_two_photographs_that_share_a_half_make_one_mosaic(captured):
    cameras, result = captured
    mosaic = result.estimate.several.mosaic
    assert 1.35 < mosaic.times < 1.75
    maps = map_set_of(result.estimate.exemplar)
    assert maps.size == mosaic.margins.around((128, 96))
    assert maps.texel_size == pytest.approx(2.0 / 128)
    assert result.estimate.first_rectangle.size == (128, 96)
    # What nobody saw is believed by nobody.
    known = seen_by_any(result.estimate.several.views, mosaic).numpy()
    trusted = result.estimate.exemplar.confidence
    assert (trusted[:, ~known] == 0.0).all() and trusted[0][known].mean() > 0.3

    other = result.estimate.several.views[1].camera
    points = grid_points(*maps.size, mosaic.extent)
    beyond = torch.from_numpy(other.shows(points, 0.75, STEEPEST))
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
    times = result.estimate.several.mosaic.times
    assert values["multi_view"]["mosaic"]["area_ratio"] == pytest.approx(times)
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


# Predictions of each photograph, resampled to the first one's frame.


OVER = (128, 96)


@pytest.fixture(scope="module")
def cameras():
    return hold(PHONE, Hand(turned=0.2), 3, 4)


def _light():
    gain = torch.tensor([0.0, 0.3, 0.0])[:, None].expand(3, 3)
    return SharedLight(torch.tensor([0.04, -0.07]), torch.zeros(2), gain, torch.full((3,), 5.0))


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
    setup, _, coordinates = own_plane(cameras[1], replace(_light(), centre=(0.1, 0.2)), 1)
    points = grid_points(16, 12)
    here = np.concatenate([coordinates(points), np.zeros((1, 12, 16))])
    seen = PosedCamera.of(setup).sees(here)
    np.testing.assert_allclose(seen, cameras[1].sees(points), atol=1e-9)
    assert setup.vignetting_centre == (0.1, 0.2)  # of image coordinates, which are the same
    # And so does its flash, as strong at its own distance.
    _, flash = camera_in_plane(setup)
    away = np.linalg.norm(flash.numpy() - here.reshape(3, -1).T, axis=1)
    place = cameras[1].flash((0.04, -0.07, 0.0))
    there = np.linalg.norm(place - points.reshape(3, -1).T, axis=1)
    irradiance = 5.0 * math.exp(0.3) / there**2
    np.testing.assert_allclose(setup.intensity[0] / away**2, irradiance, rtol=1e-6)


def test_a_prediction_is_resampled_to_the_first_photograph(cameras):
    own = own_plane(cameras[1], _light(), 1)
    views = tuple(_view(camera) for camera in cameras)
    alignment = Aligned.of(views, FlashSetup(fov=PHONE.fov))
    # The other plane's texels, as points of the first's.
    theirs = PosedCamera.of(own[0]).sees(grid_points(256, 192))
    maps = _waves(cameras[1].on_plane(theirs), 2.0 / 256)
    maps = replace(maps, height=maps.height / own[1])
    read = Estimate(maps, torch.full((4, 192, 256), -2.0))
    found, log_error, weight = resampled(read, own, alignment, 1, OVER)
    true = parameters_of(_waves(grid_points(*OVER), 2.0 / OVER[0]))
    known = weight > 0.5
    assert 0.3 < known.float().mean() < 1.0 and float((found - true)[:, known].abs().max()) < 0.03
    torch.testing.assert_close(log_error[:, known], torch.full_like(log_error[:, known], -2.0))
    # Weights fall to 0 at the border without a step.
    assert float(weight.min()) == 0.0 and float(weight.diff(dim=1).abs().max()) < 0.2
