"""Photographs in floating point: EXR, Radiance HDR, float TIFF and float DNG keep their light."""

import math

import numpy as np
import OpenImageIO as oiio
import pytest
import tifffile
from simulated.files import write_dng

from matcap.errors import MatcapError, UsageError
from matcap.files.exr import write_exr
from matcap.photo.load import load_photo


def radiance(path, light):
    spec = oiio.ImageSpec(light.shape[1], light.shape[0], 3, "float")
    out = oiio.ImageOutput.create(str(path))
    out.open(str(path), spec)
    out.write_image(light)
    out.close()


WRITERS = {
    "a.exr": lambda path, light: write_exr(path, light, half=False),
    "a.hdr": radiance,
    "a.tif": lambda path, light: tifffile.imwrite(path, light, photometric="rgb"),
    "a.dng": lambda path, light: write_dng(path, light, black=0, white=1),
}


@pytest.fixture
def bright(light):
    """(96, 128, 3) float32 linear light up to 6 times white."""
    return (8.0 * light).astype(np.float32)


@pytest.mark.parametrize("name", WRITERS)
def test_light_above_white_is_kept(tmp_path, bright, name):
    WRITERS[name](tmp_path / name, bright)
    photo = load_photo(tmp_path / name)
    np.testing.assert_allclose(photo.pixels, bright, rtol=0.01, atol=0.04)
    assert not photo.clipped.any() and photo.headroom == math.inf
    assert not photo.tone_mapped and photo.floating and photo.radiometric == (name == "a.dng")
    assert any("times white" in note for note in photo.notes)


@pytest.mark.parametrize("name", WRITERS)
def test_white_can_be_given(tmp_path, bright, name):
    WRITERS[name](tmp_path / name, bright)
    photo = load_photo(tmp_path / name, white=4.0)
    np.testing.assert_allclose(photo.pixels, bright / 4.0, rtol=0.01, atol=0.01)


@pytest.mark.parametrize("name", WRITERS)
def test_one_hot_pixel_changes_no_other(tmp_path, bright, name):
    hot = bright.copy()
    hot[40, 60] = 5000.0
    WRITERS[name](tmp_path / name, hot)
    photo = load_photo(tmp_path / name)
    others = np.ones(bright.shape[:2], bool)
    others[40, 60] = False
    np.testing.assert_allclose(photo.pixels[others], bright[others], rtol=0.01, atol=0.04)
    assert not photo.clipped.any()


def test_a_level_that_many_pixels_share_is_the_limit(tmp_path, bright):
    WRITERS["a.exr"](tmp_path / "a.exr", np.minimum(bright, 3.0))
    photo = load_photo(tmp_path / "a.exr")
    assert photo.headroom == pytest.approx(3.0, rel=1e-3)
    np.testing.assert_array_equal(photo.clipped, (bright >= 3.0 * (1.0 - 1e-4)).any(axis=2))


def test_values_up_to_white_are_unchanged(tmp_path, light):
    WRITERS["a.tif"](tmp_path / "a.tif", np.minimum(1.5 * light, 1.0).astype(np.float32))
    photo = load_photo(tmp_path / "a.tif")
    assert photo.headroom == 1.0
    np.testing.assert_array_equal(photo.clipped, (1.5 * light >= 1.0).any(axis=2))


@pytest.mark.parametrize("factor", [1e4, 1e-2])
def test_doubtful_white_gives_a_note(tmp_path, bright, factor):
    WRITERS["a.exr"](tmp_path / "a.exr", bright * np.float32(factor))
    assert any("--white" in note for note in load_photo(tmp_path / "a.exr").notes) == (factor > 1)


def test_unlit_numbers_are_refused(tmp_path, bright):
    WRITERS["a.exr"](tmp_path / "a.exr", bright * np.float32(1e-6))
    with pytest.raises(MatcapError, match="--white"):
        load_photo(tmp_path / "a.exr")
    assert load_photo(tmp_path / "a.exr", white=1e-5).pixels.max() > 0.5


@pytest.mark.parametrize("white", [0.0, -1.0, math.nan, math.inf])
def test_a_senseless_white_is_a_usage_error(tmp_path, bright, white):
    WRITERS["a.exr"](tmp_path / "a.exr", bright)
    with pytest.raises(UsageError, match="white"):
        load_photo(tmp_path / "a.exr", white=white)


def test_a_float_mosaic_is_averaged(tmp_path, bright):
    rows, columns = np.indices(bright.shape[:2])
    of = np.array([[0, 1], [1, 2]])[rows % 2, columns % 2]
    samples = np.take_along_axis(bright, of[..., None], axis=2)[..., 0]
    write_dng(tmp_path / "a.dng", samples, black=0, white=1, neutral=(0.5, 1.0, 0.8))
    photo = load_photo(tmp_path / "a.dng")
    means = bright.reshape(48, 2, 64, 2, 3).mean(axis=(1, 3)) / (0.5, 1.0, 0.8)
    assert photo.pixels.shape == means.shape and photo.original_size == (128, 96)
    # The colour matrix maps the neutral to white: ratios of white-balanced channels are kept.
    np.testing.assert_allclose(photo.pixels.mean(), means.mean(), rtol=0.3)
    assert photo.balance == pytest.approx((2.0, 1.0, 1.25), rel=1e-3)


def test_a_two_channel_exr_is_refused(tmp_path, bright):
    spec = oiio.ImageSpec(128, 96, 2, "float")
    spec.channelnames = ("R", "G")
    out = oiio.ImageOutput.create(str(tmp_path / "a.exr"))
    out.open(str(tmp_path / "a.exr"), spec)
    out.write_image(np.ascontiguousarray(bright[..., :2]))
    out.close()
    with pytest.raises(MatcapError, match="two channels"):
        load_photo(tmp_path / "a.exr")
