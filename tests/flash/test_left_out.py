"""Crop and mask: what is none of the material is not measured, and the geometry stays."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from uniform import a_setup, photograph

from matcap.batch.settings import read_settings
from matcap.capture.rectified import fill_masked
from matcap.capture.settings import CaptureSettings
from matcap.errors import MatcapError, UsageError
from matcap.files.values import Rectangle
from matcap.flash.coarse.fit import fit_coarse
from matcap.flash.plane import read_plane
from matcap.photo.border import border_crop
from matcap.photo.inspect import inspect_photo
from matcap.photo.left_out import leave_out

LABEL = (9.0, 0.1, 0.1)


WIDTH, HEIGHT = 128, 96  # pixels


@pytest.fixture(scope="module")
def photo():
    return photograph(a_setup())


def labelled(photo, rows, columns):
    pixels = photo.pixels.copy()
    pixels[rows, columns] = LABEL
    return replace(photo, pixels=pixels)


def a_mask(path, rows, columns):
    mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
    mask[rows, columns] = 0
    cv2.imwrite(str(path), mask)
    return path


def test_a_crop_leaves_the_photograph_its_size_and_shows_mirrors(photo):
    found = leave_out(
        labelled(photo, slice(None), slice(WIDTH - 60, None)),
        Rectangle(0, 0, photo.original_size[0] - 60, photo.original_size[1]),
        None,
    )
    assert found.pixels.shape == photo.pixels.shape and found.pixels.max() < LABEL[0]
    assert found.left_out[:, -60:].all() and not found.left_out[:, :-60].any()
    np.testing.assert_array_equal(found.pixels[:, -55], found.pixels[:, -67])
    assert found.kept_share == pytest.approx(1.0 - 60 / WIDTH)
    assert leave_out(photo, None, None) is photo


def test_a_turned_photograph_is_cropped_as_it_is_looked_at(photo):
    standing = replace(photo, turned=True, original_size=(HEIGHT, WIDTH))
    found = leave_out(standing, Rectangle(0, 0, HEIGHT, WIDTH // 2), None)
    # The top of what stands is to the left of what lies, turned anticlockwise.
    assert found.left_out[:, WIDTH // 2 + 1 :].all() and not found.left_out[:, : WIDTH // 2].any()


def test_a_fit_beside_a_label_is_that_without_it(photo, tmp_path):
    part = slice(HEIGHT - 90, None), slice(WIDTH - 150, None)
    mask = a_mask(tmp_path / "mask.png", *part)
    found = leave_out(labelled(photo, *part), None, mask)
    clean, fit = fit_coarse(photo), fit_coarse(found)
    assert fit.setup.offset[:2] == pytest.approx(clean.setup.offset[:2], abs=0.02)
    assert fit.setup.tilt == pytest.approx(clean.setup.tilt, abs=0.01)
    assert fit.roughness == pytest.approx(clean.roughness, abs=0.02)
    assert fit.diffuse[0] / fit.diffuse[2] == pytest.approx(
        clean.diffuse[0] / clean.diffuse[2], rel=0.02
    )


def test_the_plane_knows_what_is_left_out_and_lights_its_mirror(photo, tmp_path):
    part = slice(None), slice(WIDTH - WIDTH // 4, None)
    mask = a_mask(tmp_path / "mask.png", *part)
    found = leave_out(labelled(photo, *part), None, mask)
    coarse = fit_coarse(found)
    plane = fill_masked(read_plane(found, coarse.setup, 128), coarse)
    whole = read_plane(photo, coarse.setup, 128)
    assert plane.size == whole.size
    assert not (plane.valid & plane.left_out).any() and plane.left_out[:, 100:].all()
    assert not plane.measured[:, plane.left_out].any()
    # A uniform material's mirror, lit as its place is, is the photograph that was left out.
    again = plane.linear[:, 20:-20, 104:124] / whole.linear[:, 20:-20, 104:124]
    assert float(again.min()) > 0.85 and float(again.max()) < 1.15
    assert plane.shrunk(64).left_out[:, 50:].all()


@pytest.mark.parametrize(
    ("crop", "says"),
    [
        (Rectangle(100, 0, 10_000, 200), "reaches beyond the photograph"),
        (Rectangle(-1, 0, 200, 200), "reaches beyond the photograph"),
        (Rectangle(0, 0, 20, 96), "too few to hold a texture"),
    ],
)
def test_a_crop_that_cannot_be_is_said(photo, crop, says):
    with pytest.raises(UsageError, match=says):
        leave_out(photo, crop, None)


def test_a_mask_that_does_not_fit_is_said(photo, tmp_path):
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), np.zeros((8, 9), np.uint8))
    black = a_mask(tmp_path / "black.png", slice(None), slice(None))
    (tmp_path / "text.png").write_text("no picture")
    for mask, says in (
        (small, "the mask is 9 x 8 pixels, the photograph"),
        (black, "the mask leaves 0 % of the photograph"),
        (tmp_path / "text.png", "not a readable picture"),
        (tmp_path / "none.png", "there is no such file"),
    ):
        with pytest.raises(MatcapError, match=says):
            leave_out(photo, None, mask)


def test_a_mask_of_specks_hides_no_light(photo, tmp_path):
    mask = tmp_path / "specks.png"
    rows, columns = np.indices((HEIGHT, WIDTH))
    cv2.imwrite(str(mask), np.where((rows + columns) % 2, 255, 0).astype(np.uint8))
    found = fit_coarse(leave_out(photo, None, mask)).setup
    assert found.offset[:2] == pytest.approx((0.1, 0.05), abs=0.03)


def test_settings_say_it_where_it_is_set_alone(tmp_path):
    assert not {"crop", "mask"} & set(CaptureSettings().named())
    settings = CaptureSettings.of({"crop": "1,2,300,400", "mask": "a.png"})
    assert settings.crop == Rectangle(1, 2, 300, 400)
    assert CaptureSettings.of(settings.named()) == settings
    (tmp_path / "matcap.toml").write_text('crop = "0,0,640,480"\nmask = "table.png"\n')
    read = read_settings(tmp_path / "matcap.toml")
    assert read["crop"] == Rectangle(0, 0, 640, 480) and read["mask"] == tmp_path / "table.png"
    with pytest.raises(UsageError, match="no rectangle|not a rectangle"):
        CaptureSettings.of({"crop": "1,2,3"})


def test_a_border_that_is_another_thing_is_proposed_to_be_cut_off(photo):
    assert border_crop(photo) is None
    edged = labelled(photo, slice(HEIGHT - 14, None), slice(None))
    crop = border_crop(edged)
    assert (crop.x, crop.y, crop.width) == (0, 0, WIDTH)
    assert HEIGHT - 22 <= crop.height <= HEIGHT - 14
    standing = replace(edged, turned=True, original_size=(HEIGHT, WIDTH))
    crop = border_crop(standing)
    assert (crop.y, crop.height) == (0, WIDTH) and 14 <= crop.x <= 22
    result = [found for found in inspect_photo(edged).findings if found.name == "crop"]
    assert "--crop 0,0," in result[0].remedy
    assert not any(found.name == "crop" for found in inspect_photo(photo).findings)
    spotted = photo.pixels * (1.0 + 0.4 * (np.indices((HEIGHT, WIDTH)).sum(0) // 8 % 2))[..., None]
    assert border_crop(replace(photo, pixels=spotted.astype(np.float32))) is None
