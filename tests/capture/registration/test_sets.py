"""Registration of sets of photographs."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from simulated.materials import piece
from simulated.photographs import Hand, PhoneCamera, as_photo, hold, take, true_maps

from matcap.capture.registration.camera import PosedCamera
from matcap.capture.registration.keypoints import is_periodic, losses_of_sharpness, shares_in_shadow
from matcap.capture.registration.register import (
    flash_first,
    register,
    register_in_any_order,
    without_flash,
)
from matcap.errors import MatcapError
from matcap.flash.geometry import FlashSetup
from matcap.photo.left_out import area_averaged
from matcap.photo.photo import Photo

# Photographs taken without the flash among flash photographs.


CAMERA = PhoneCamera(width=320, height=240, supersampling=1)


@pytest.fixture(scope="module", params=["granite", "plaster", "leather"])
def pair(request):
    """A flash photograph, and its albedo under the light of a window."""
    sample = piece(request.param)
    setup = FlashSetup(offset=(0.1, 0.05, 0.0), tilt=(0.02, -0.02))
    flash = as_photo(take(sample, CAMERA, setup), 1, "flash")
    albedo = true_maps(sample, CAMERA).diffuse.numpy().transpose(1, 2, 0)
    window = np.linspace(0.9, 1.1, CAMERA.width)[None, :, None]
    pixels = np.ascontiguousarray((0.8 * albedo * window).clip(0.0, 1.0), np.float32)
    return flash, replace(flash, pixels=pixels, clipped=pixels.max(-1) >= 1.0, name="ambient")


def test_flash_in_metadata_counts(pair):
    flash, ambient = pair
    result = without_flash([flash, flash, replace(ambient, flash_fired=False)])
    assert list(result) == [2] and "did not fire" in result[2]
    assert without_flash([flash, flash]) == {}
    # That a flash fired is believed, however little of it shows.
    assert without_flash([flash, replace(ambient, flash_fired=True)]) == {}


def test_flash_is_found_by_the_light_without_metadata(pair):
    flash, ambient = (replace(photo, flash_fired=None) for photo in pair)
    result = without_flash([flash, ambient, flash])
    assert list(result) == [1] and "shows no flash" in result[1]


def test_photographs_without_any_flash_name_none(pair):
    unsaid = replace(pair[1], flash_fired=None)
    assert without_flash([unsaid, unsaid]) == {}
    never = replace(pair[0], flash_fired=False)
    assert without_flash([never, never]) == {}


@pytest.mark.parametrize("pair", ["plaster"], indirect=True)
def test_a_photograph_without_flash_is_last_and_gives_no_frame(pair):
    flash, ambient = pair[0], replace(pair[1], flash_fired=False)
    assert flash_first([ambient, flash, flash]) == [flash, flash, ambient]
    setup = FlashSetup(fov=CAMERA.fov)
    found = register([flash, flash, ambient, replace(ambient, name="again")], setup)
    assert [view.flash for view in found.views] == [True, True, False]
    (worse,) = found.left_out
    assert "did not fire" in worse.why and "shows the ambient light better" in worse.why
    with pytest.raises(MatcapError, match="with flash first"):
        register([ambient, flash], setup)


# Periodic weaves, whose photographs could be registered a period off.


PHONE = PhoneCamera(width=480, height=360)
FINE = 2  # samples along a pixel's side
HELD = Hand()


def _smooth(rng, deviation):
    noise = cv2.GaussianBlur(rng.normal(size=(1024, 1024)).astype(np.float32), (0, 0), deviation)
    return noise / noise.std()


def _weave(thread, clouds, flaws):
    """Albedo of plane points (3, h, w): threads of a width; log contrast of clouds and flaws."""
    rng = np.random.default_rng(1)
    irregular = clouds * _smooth(rng, 30.0) + flaws * _smooth(rng, 1.0)

    def albedo(points):
        x = np.cos(0.2) * points[0] + np.sin(0.2) * points[1]
        y = np.cos(0.2) * points[1] - np.sin(0.2) * points[0]
        u, v = np.sin(np.pi * x / thread), np.sin(np.pi * y / thread)
        woven = np.where(u * v > 0.0, np.abs(u) ** 0.7, 0.75 * np.abs(v) ** 0.7)
        place = [((p + 2.0) * 255.75).astype(np.float32) for p in points[:2]]
        return (0.1 + 0.4 * woven) * np.exp(cv2.remap(irregular, *place, cv2.INTER_LINEAR))

    return albedo


def _photographs(albedo, count=2, hand=HELD):
    """Cameras, and their flash photographs of an albedo."""
    cameras, photos = hold(PHONE, hand, count, 5), []
    columns, rows = PHONE.width * FINE, PHONE.height * FINE
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    image = np.stack([x - columns / 2.0, rows / 2.0 - y]) / (columns / 2.0)
    for number, camera in enumerate(cameras):
        points = camera.on_plane(image)
        away = camera.flash((0.04, -0.07, 0.0))[:, None, None] - points
        lit = albedo(points) * away[2] / np.square(away).sum(0) ** 1.5
        size = (PHONE.width, PHONE.height)
        small = cv2.resize(lit / lit.max(), size, interpolation=cv2.INTER_AREA)
        noise = np.random.default_rng(number).normal(size=(*small.shape, 3))
        pixels = (0.9 * small[..., None] + 0.003 * noise).clip(1e-4, 1.0).astype(np.float32)
        clipped = (pixels >= 1.0).any(-1)
        photos.append(Photo(pixels, clipped, PHONE.fov, "exif", True, f"p{number}", size))
    return cameras, photos


@pytest.mark.parametrize(("thread", "clouds", "flaws"), [(0.04, 0.1, 0.1), (0.1, 0.1, 0.05)])
def test_a_weave_with_flaws_is_registered(thread, clouds, flaws):
    cameras, photos = _photographs(_weave(thread, clouds, flaws))
    found = register(photos, FlashSetup(fov=PHONE.fov))
    assert len(found.views) == 2 and is_periodic(photos[0])
    points = np.stack([*np.random.default_rng(0).uniform(-0.5, 0.5, (2, 200)), np.zeros(200)])
    first, second = (view.camera for view in found.views)
    there = second.on_plane(cameras[1].sees(cameras[0].on_plane(first.sees(points))))
    assert np.hypot(*(there - points)[:2]).max() < 0.1 * thread


def test_a_flawless_weave_is_refused_in_one_sentence():
    _, photos = _photographs(_weave(0.04, 0.0, 0.0))
    (refused,) = register(photos, FlashSetup(fov=PHONE.fov)).left_out
    assert "pattern repeats" in refused.why and "border" in refused.why


def test_grain_has_no_period():
    _, photos = _photographs(_weave(1e9, 0.1, 0.3))  # of one thread
    assert not is_periodic(photos[0])


def _grey(pixels, name):
    """A RAW photograph of grey pixels (H, W), 1000 across."""
    shrunk = np.repeat(area_averaged(pixels, (1000, 750))[..., None], 3, axis=2)
    clipped = np.zeros(shrunk.shape[:2], bool)
    return Photo(
        shrunk, clipped, 60.0, "exif", radiometric=True, name=name, original_size=(1000, 750)
    )


def test_a_photograph_from_farther_away_is_not_blurred():
    """At 1.5 times the distance a pixel shows more of the sample."""
    noise = cv2.GaussianBlur(np.random.default_rng(0).normal(size=(2250, 3000)), (0, 0), 1.5)
    whole = np.exp(noise).astype(np.float32)
    near = PosedCamera.of(FlashSetup(fov=60.0))
    far = replace(near, place=1.5 * near.place)
    photos = _grey(whole[375:-375, 500:-500], "near"), _grey(whole, "far")
    sharp, loss = losses_of_sharpness(photos, (near, far))
    assert sharp == 0.0 and loss < 0.12


# Photographs of a set that is not perfect: which of them defines the frame.


@pytest.fixture(scope="module")
def grain():
    """Three photographs of grain."""
    return _photographs(_weave(1e9, 0.1, 0.3), 3)[1]


def _names(found):
    return [view.photo.name for view in found.views], [one.name for one in found.left_out]


def test_a_copy_counts_once(grain):
    copy = replace(grain[0], pixels=grain[0].pixels.copy(), name="copy")
    found = register_in_any_order([grain[0], copy, grain[1], grain[1]])
    assert _names(found) == (["p0", "p1"], ["copy", "p1"])
    assert found.left_out[0].why == "it is p0 again, which counts once"
    assert found.frame is None


@pytest.mark.parametrize("count", [2, 3])
def test_a_blurred_first_gives_way(grain, count):
    smeared = cv2.blur(grain[0].pixels, (9, 1))
    found = register_in_any_order([replace(grain[0], pixels=smeared), *grain[1:count]])
    assert found.views[0].photo is grain[1] and _names(found)[1] == ["p0"]
    assert "blurred" in found.left_out[0].why
    assert found.frame == "The maps show what p1 shows, not p0: that is blurred."


def _shadowed(photo):
    dark = photo.pixels.copy()
    dark[180:, 240:] *= 0.2
    return replace(photo, pixels=dark)


@pytest.mark.parametrize("count", [2, 3])
def test_a_first_in_shadow_gives_way_and_is_used(grain, count):
    found = register_in_any_order([_shadowed(grain[0]), *grain[1:count]])
    assert found.views[0].photo is not grain[0] and len(found.views) == count
    assert not found.left_out and "of that is in shadow" in found.frame


def test_a_better_one_is_named_by_the_place_it_was_given(grain):
    """One that is left out stands before it."""
    other = replace(_photographs(_weave(0.1, 0.1, 0.05))[1][0], name="other")
    found = register_in_any_order([_shadowed(grain[0]), other, *grain[1:]])
    assert len(found.views) == 3 and [one.name for one in found.left_out] == ["other"]


def test_a_stranger_of_the_same_name_does_not_move_the_frame(grain):
    other = replace(_photographs(_weave(0.1, 0.1, 0.05))[1][0], name="p1")
    found = register_in_any_order([*grain, other])
    assert found.views[0].photo is grain[0] and found.frame is None


def test_a_shadow_is_of_the_photograph_that_is_darker(grain):
    views = register(grain, FlashSetup(fov=PHONE.fov)).views
    cameras = [view.camera for view in views]
    assert max(shares_in_shadow(list(zip(grain, cameras, strict=True)))) < 0.02
    dark = [grain[0], _shadowed(grain[1]), grain[2]]
    shares = shares_in_shadow(list(zip(dark, cameras, strict=True)))
    assert 0.15 < shares[1] < 0.4 and max(shares[0], shares[2]) < 0.02


def test_a_first_of_another_sample_gives_way(grain):
    other = replace(_photographs(_weave(0.1, 0.1, 0.05))[1][0], name="other")
    found = register_in_any_order([other, *grain])
    assert _names(found) == (["p0", "p1", "p2"], ["other"])
    assert "2 others match it, 0 the first" in found.frame


def test_the_photograph_that_others_overlap_most_defines_the_frame():
    photos = _photographs(_weave(1e9, 0.1, 0.3), 5, Hand(aside=0.55, aimed=1.0))[1]
    found = register_in_any_order([photos[1], photos[0], *photos[2:]])
    assert found.views[0].photo is photos[0] and "the others show" in found.frame
    assert register_in_any_order(photos).frame is None
