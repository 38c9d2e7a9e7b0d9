"""A photograph without flash: ambient light is subtracted, and it measures albedo."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from seen_views import flattened, grainy, photographed, seen_by
from simulated.files import write_shot
from simulated.materials import piece
from simulated.photographs import (
    Hand,
    PhoneCamera,
    as_photo,
    hold,
    take_several,
    take_without_flash,
    true_maps_along,
)

from matcap.brdf.maps import normals_from_slopes
from matcap.capture.exemplar.relief_spectrum import slope_spectrum
from matcap.capture.inspection import coverage
from matcap.capture.multiview.pair import on_albedo, scaled_by_ratio, with_ambient_gradient
from matcap.capture.multiview.solve import solve
from matcap.capture.multiview.texels import SLOPES, Estimate, parameters_of
from matcap.capture.multiview.views import (
    RAW_FALLOFF,
    AmbientLight,
    SharedLight,
    evenly_lit,
    without_ambient,
)
from matcap.capture.pipeline import capture_photo
from matcap.capture.registration.camera import grid_points
from matcap.capture.registration.register import RegisteredView, Registration, register_in_any_order
from matcap.capture.report import warnings
from matcap.capture.run import capture_into
from matcap.capture.settings import CaptureSettings, OutputSettings
from matcap.flash.geometry import FlashSetup

PHONE = PhoneCamera(width=480, height=360, supersampling=1)
HAND = Hand(room=0.1, balanced=0.0)
SIZE, LARGE = (72, 96), (288, 384)  # texels


@pytest.fixture(scope="module")
def lit():
    """Shots of leather in a lit room, what they would be in the dark, and one without flash."""
    sample = piece("leather")
    cameras = hold(PHONE, HAND, 3, 5)
    bright = take_several(sample, PHONE, cameras, HAND, 5)
    dark = take_several(sample, PHONE, cameras, replace(HAND, room=0.0), 5)
    return cameras, bright, dark, take_without_flash(sample, PHONE, cameras, HAND, 6)


def _registration(lit, **changes):
    cameras, bright, _, (room, camera) = lit
    photos = [as_photo(shot, n, f"l{n}") for n, shot in enumerate(bright)]
    views = map(RegisteredView, photos, cameras)
    unlit = RegisteredView(replace(as_photo(room, 9, "room"), **changes), camera, flash=False)
    return Registration(FlashSetup(fov=PHONE.fov), (*views, unlit), ())


def test_ambient_light_is_subtracted(lit):
    _, bright, dark, _ = lit
    cleaned = without_ambient(_registration(lit).views)
    for view, shot, true in zip(cleaned, bright, dark, strict=False):
        before = shot.linear / shot.exposure
        wanted = true.linear / true.exposure
        after = view.photo.pixels / shot.exposure
        logs = (np.log(one.mean((0, 1)) / wanted.mean((0, 1))) for one in (before, after))
        off = [np.abs(log).max() for log in logs]
        assert off[1] < 0.03 < 0.1 < off[0]
        assert any("subtracted" in note for note in view.photo.notes)
    assert cleaned[-1].photo.name == "room" and not cleaned[-1].photo.notes


def test_a_photograph_without_flash_is_registered_on_albedo(lit):
    registration = _registration(lit)
    room, cameras = registration.views[-1], lit[0]
    astray = replace(room.camera, place=room.camera.place + np.array([0.012, -0.02, 0.01]))
    off = (*registration.views[:-1], replace(room, camera=astray, misregistration=0.02))
    maps = true_maps_along(piece("leather"), PHONE, cameras, 0, cameras[0], (320, 240))
    found = on_albedo(off, maps)
    points = grid_points(32, 24)
    before, after = (
        160.0 * np.hypot(*(one.sees(points) - room.camera.sees(points))).max()
        for one in (astray, found[-1].camera)
    )
    assert after < 1.0 < 3.0 < before
    sure = (*registration.views[:-1], replace(room, misregistration=0.001))
    assert on_albedo(sure, maps)[-1].camera is room.camera


def test_without_a_dark_photograph_registration_is_unchanged(lit):
    flashes = _registration(lit).views[:-1]
    assert on_albedo(flashes, grainy(0)) is flashes


def test_a_photograph_of_another_surface_is_refused_in_a_sentence(lit):
    room, _ = lit[-1]
    _, (plaster,) = photographed("plaster", PHONE, 1, 5, hand=HAND)
    settings, others = CaptureSettings(preset="instant", detail=192), [as_photo(room, 2, "leather")]
    said = " ".join(warnings(capture_photo(plaster, settings, others=others)))
    assert "leather was left out: the flash did not fire" in said
    assert f"The maps are those of {plaster.name} alone" in said


def test_unknown_exposures_subtract_nothing(lit):
    registration = _registration(lit, exposure=None)
    assert without_ambient(registration.views) == registration.views


def test_wrong_exposures_leave_most_of_the_light(lit):
    registration = _registration(lit, exposure=lit[-1][0].exposure / 100.0)
    cleaned = without_ambient(registration.views)
    for view, before in zip(cleaned[:-1], registration.views[:-1], strict=True):
        assert (view.photo.pixels >= 0.04 * before.photo.pixels).all()
        assert view.photo.pixels.mean() > 0.2 * before.photo.pixels.mean()


def test_the_subtracted_light_is_white_balanced(lit):
    plain = without_ambient(_registration(lit).views)
    lifted = without_ambient(_registration(lit, balance=(2.0, 1.0, 1.0)).views)
    before = _registration(lit).views[0].photo.pixels
    added = [before - one[0].photo.pixels for one in (plain, lifted)]
    ratio = added[1].mean((0, 1)) / added[0].mean((0, 1))
    np.testing.assert_allclose(ratio, [0.5, 1.0, 1.0], rtol=0.02)


def test_clipped_texels_stay_clipped(lit):
    registration = _registration(lit)
    first = registration.views[0]
    full = np.zeros(first.photo.clipped.shape, bool)
    full[100:110] = True
    pixels = np.where(full[..., None], np.float32(1.0), first.photo.pixels)
    view = replace(first, photo=replace(first.photo, pixels=pixels, clipped=full))
    assert (without_ambient((view, *registration.views[1:]))[0].photo.pixels[full] == 1.0).all()


def test_slow_ambient_light_is_removed():
    maps = grainy(0, SIZE, albedo=0.4)
    even = (maps.diffuse + maps.specular).log()
    uneven = even + torch.linspace(-0.5, 0.5, SIZE[1])
    found = evenly_lit(uneven, torch.ones_like(even, dtype=torch.bool), even)
    inner = (..., slice(12, -12), slice(12, -12))
    assert (found - even)[inner].abs().mean() < 0.02 < 0.2 * (uneven - even)[inner].abs().mean()


def test_an_even_sky_darkens_slopes_and_a_window_lights_its_side():
    normal = normals_from_slopes(torch.tensor([[[0.0, 1.0, 1.0]]]), torch.zeros(1, 1, 3))
    sky = AmbientLight().onto(normal).irradiance[0, 0]
    np.testing.assert_allclose(sky, 0.5 + 0.5 * normal[2, 0], rtol=1e-6)
    window = AmbientLight(torch.tensor([0.4, 0.0, 0.5])).onto(normal).irradiance[0, 0]
    np.testing.assert_allclose(window - sky, 0.4 * normal[0, 0], atol=1e-6)


def _pair(maps, gradient):
    """Views of maps with a flash and in a room of such light, and the light."""
    cameras = hold(PHONE, Hand(), 1, 1)
    light = SharedLight(torch.zeros(2), torch.zeros(2), torch.zeros(2, 3), torch.full((3,), 5.0))
    true = replace(light, ambient=torch.tensor(gradient))
    return *(seen_by(cameras[0], n, maps, true, flash=n == 0) for n in (0, 1)), light


def test_a_windows_side_is_found_by_the_contrast_of_the_ratio():
    flash, room, light = _pair(grainy(2, LARGE, albedo=0.4), (-0.3, 0.2, 0.5))
    flat = parameters_of(grainy(3, LARGE, albedo=0.4))
    found = with_ambient_gradient([flash, room], flat, light)
    np.testing.assert_allclose(found.ambient, (-0.3, 0.2, 0.5), atol=0.12)


def test_relief_is_scaled_to_the_ratio_of_flash_and_ambient():
    maps = grainy(4, LARGE, albedo=0.4)
    flash, room, light = _pair(maps, (-0.3, 0.2, 0.5))
    light = with_ambient_gradient([flash, room], parameters_of(maps), light)
    found = scaled_by_ratio(0.4 * maps.height, [flash, room], parameters_of(maps), light)
    wanted, seen = (
        slope_spectrum(h[0].numpy() / maps.texel_size)[1:4] ** 2 for h in (maps.height, found)
    )
    np.testing.assert_allclose(np.sqrt(seen.sum() / wanted.sum()), 1.0, atol=0.15)


def test_ambient_light_improves_albedo_and_slopes():
    maps = grainy(1, SIZE, albedo=0.4)
    flash, room, light = _pair(maps, (-0.3, -0.1, 0.5))
    log_error = torch.log(torch.tensor([0.5, 0.2, 0.2, 0.5]))[:, None, None].expand(4, *SIZE)
    off, astray = [], []
    for views in ([flash], [flash, room]):
        some = light.of_some(range(len(views)))
        some = replace(some, vignetting_deviation=RAW_FALLOFF)
        found = solve(views, Estimate(flattened(maps), log_error), some)
        log = (found.maps.diffuse / maps.diffuse).log()
        off.append(float((log - log.median()).abs().mean()))
        slopes = parameters_of(found.maps)[SLOPES] - parameters_of(maps)[SLOPES]
        astray.append(float(slopes.square().mean().sqrt()))
    assert off[1] < 0.7 * off[0] and astray[1] < 0.8 * astray[0]


def test_one_photograph_with_flash_and_one_without_make_a_capture(lit, tmp_path):
    _, bright, _, (room, _) = lit
    paths = [tmp_path / "room.dng", tmp_path / "leather.dng"]
    for path, shot in zip(paths, (room, bright[0]), strict=True):
        write_shot(path, shot, 1)
    settings = CaptureSettings(preset="instant", detail=128)
    result = capture_into(tmp_path / "out", paths, settings, OutputSettings((32, 32)))
    assert result.material.name == "out" or result.photo.name == "leather.dng"
    values = json.loads((tmp_path / "out/report.json").read_text())["multi_view"]
    lit_by = [(one["name"], one["flash"]) for one in values["photographs"]]
    assert lit_by == [("leather.dng", True), ("room.dng", False)]
    assert values["photographs"][1]["leave_one_out_residual"] is None
    assert any("subtracted" in note for note in result.photo.notes)


def _smeared(photo):
    kernel = np.ones(9) / 9.0
    pixels = np.apply_along_axis(lambda row: np.convolve(row, kernel, "same"), 1, photo.pixels)
    return replace(photo, pixels=pixels.astype(np.float32), name=f"smeared_{photo.name}")


def test_a_blurred_photograph_is_named(held):
    _, photos = held
    found = register_in_any_order([photos[0], photos[1], _smeared(photos[2])])
    assert [view.photo.name for view in found.views] == ["plaster_0", "plaster_1"]
    assert [one.name for one in found.left_out] == ["smeared_plaster_2"]
    assert "it is blurred" in found.left_out[0].why and not found.blurred
    assert "smeared_plaster_2 does not belong" in coverage(found)["belong"].says


def test_a_blurred_first_photograph_does_not_define_the_frame(held):
    _, photos = held
    found = register_in_any_order([_smeared(photos[0]), photos[1], photos[2]])
    assert [view.photo.name for view in found.views] == ["plaster_1", "plaster_2"]
    assert [one.name for one in found.left_out] == ["smeared_plaster_0"]
