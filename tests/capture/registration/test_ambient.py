"""Photographs taken without the flash among flash photographs."""

from dataclasses import replace

import numpy as np
import pytest
from simulated.materials import piece
from simulated.photographs import PhoneCamera, as_photo, take, true_maps

from matcap.capture.registration.register import flash_first, register, without_flash
from matcap.errors import MatcapError
from matcap.flash.geometry import FlashSetup

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


def test_what_the_file_says_counts(pair):
    flash, ambient = pair
    result = without_flash([flash, flash, replace(ambient, flash_fired=False)])
    assert list(result) == [2] and "did not fire" in result[2]
    assert without_flash([flash, flash]) == {}
    # That a flash fired is believed, however little of it shows.
    assert without_flash([flash, replace(ambient, flash_fired=True)]) == {}


def test_light_tells_where_the_file_does_not(pair):
    flash, ambient = (replace(photo, flash_fired=None) for photo in pair)
    result = without_flash([flash, ambient, flash])
    assert list(result) == [1] and "shows no flash" in result[1]


def test_where_no_flash_shows_at_all_none_is_named(pair):
    unsaid = replace(pair[1], flash_fired=None)
    assert without_flash([unsaid, unsaid]) == {}
    never = replace(pair[0], flash_fired=False)
    assert without_flash([never, never]) == {}


@pytest.mark.parametrize("pair", ["plaster"], indirect=True)
def test_it_comes_last_and_gives_no_frame(pair):
    flash, ambient = pair[0], replace(pair[1], flash_fired=False)
    assert flash_first([ambient, flash, flash]) == [flash, flash, ambient]
    setup = FlashSetup(fov=CAMERA.fov)
    found = register([flash, flash, ambient, replace(ambient, name="again")], setup)
    assert [view.flash for view in found.views] == [True, True, False]
    (worse,) = found.left_out
    assert "did not fire" in worse.why and "shows the ambient light better" in worse.why
    with pytest.raises(MatcapError, match="with flash first"):
        register([ambient, flash], setup)
