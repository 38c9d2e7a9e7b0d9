"""Rectification, and parts left out."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from uniform import a_setup, photograph

from matcap.batch.samples import read_settings
from matcap.capture.rectified import fill_masked
from matcap.capture.settings import CaptureSettings
from matcap.errors import MatcapError, UsageError
from matcap.files.settings import Rectangle
from matcap.flash.coarse.fit import fit_coarse
from matcap.flash.geometry import project, unproject
from matcap.flash.rectify import inside, plane_of, read_plane, rectify
from matcap.photo.inspect import inspect_photo
from matcap.photo.left_out import border_crop, largest_rectangle, leave_out
from matcap.photo.photo import Photo

# A photograph on its plane: a tilt is undone, colours are compared, gaps are known.


def photo_of(pixels, clipped=None):
    height, width = pixels.shape[:2]
    if clipped is None:
        clipped = np.zeros((height, width), bool)
    pixels = pixels.astype(np.float32)
    return Photo(pixels, clipped, 65.0, "given", True, "made", (width, height))


def spot(setup, x, y, size=(128, 96)):
    """A photograph of one bright spot at a point of the plane."""
    width, height = size
    rows, columns = np.indices((height, width))
    u, v = project(torch.tensor([x, y, 0.0], dtype=torch.float64), setup).tolist()
    column, row = (u + 1.0) * width / 2.0 - 0.5, height / 2.0 - v * width / 2.0 - 0.5
    bright = np.exp(-0.5 * ((columns - column) ** 2 + (rows - row) ** 2) / 2.0**2)
    return photo_of(np.repeat(bright[..., None], 3, axis=2))


def test_rectifying_without_tilt_at_full_size_is_the_identity():
    pixels = np.random.default_rng(0).random((24, 32, 3), np.float32)
    linear, valid = rectify(photo_of(pixels), a_setup(), 32)
    np.testing.assert_allclose(linear.numpy(), pixels.transpose(2, 0, 1), rtol=1e-5, atol=1e-6)
    assert bool(valid.all())


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.2, 0.0), (0.0, -0.25), (0.15, 0.2)])
@pytest.mark.parametrize("place", [(0.0, 0.0), (0.5, 0.3), (-0.6, -0.4)])
def test_a_spot_is_rectified_to_its_place_on_the_plane(tilt, place):
    setup = a_setup(tilt=tilt)
    linear, _ = rectify(spot(setup, *place), setup, 128)
    weight = linear[0] / linear[0].sum()
    rows, columns = torch.meshgrid(torch.arange(96.0), torch.arange(128.0), indexing="ij")
    x = float((weight * (columns + 0.5)).sum()) * 2.0 / 128 - 1.0
    y = (96 - 2.0 * float((weight * (rows + 0.5)).sum())) / 128
    assert (x, y) == pytest.approx(place, abs=0.4 * 2.0 / 128)


def test_radiance_is_kept_where_it_was_seen():
    setup = a_setup(tilt=(0.2, -0.1))
    picture = photograph(setup)
    linear, valid = rectify(picture, setup, 128)
    places = torch.tensor([[0.0, 0.3, -0.4], [0.0, 0.2, 0.1], [0.0] * 3], dtype=torch.float64)
    for x, y, a, b in [*zip(*places[:2].tolist(), *project(places, setup).tolist(), strict=True)]:
        texel = linear[:, int(48 - y * 64), int((x + 1) * 64)]
        pixel = picture.pixels[int(48 - b * 64), int((a + 1) * 64)]
        assert texel.numpy() == pytest.approx(pixel, rel=0.06)
    assert 0.7 < float(valid.float().mean()) < 1.0


def test_unseen_texels_are_invalid():
    setup = a_setup(tilt=(0.0, 0.4))
    _, valid = rectify(photograph(setup), setup, 128)
    rows, columns = np.indices((96, 128))
    points = np.stack([(columns + 0.5) / 64 - 1, (48 - rows - 0.5) / 64, 0.0 * rows])
    points = torch.from_numpy(points)
    u, v = project(points, setup)
    inside = (u.abs() < 1.0) & (v.abs() < 0.75)
    border = ((u.abs() - 1.0).abs() < 0.02) | ((v.abs() - 0.75).abs() < 0.02)
    assert torch.equal(valid[~border], inside[~border])
    assert torch.allclose(unproject(torch.stack([u, v]), setup), points, atol=1e-9)


def test_clipped_pixels_are_invalid_and_their_neighbours_valid():
    clipped = np.zeros((96, 128), bool)
    clipped[40:60, 50:70] = True
    _, valid = rectify(photo_of(np.full((96, 128, 3), 0.5), clipped), a_setup(), 128)
    assert not bool(valid[41:59, 51:69].any())
    assert float(valid.float().mean()) == pytest.approx(1.0 - 400 / (96 * 128), abs=0.01)


@pytest.mark.parametrize(("from_size", "detail"), [((64, 48), 128), ((512, 384), 128)])
def test_detail_sets_the_size_whatever_the_photographs(from_size, detail):
    linear, valid = rectify(photograph(a_setup(), size=from_size), a_setup(), detail)
    assert linear.shape == (3, detail * 3 // 4, detail) and valid.shape == linear.shape[1:]
    mean = photograph(a_setup()).pixels.mean()
    assert float(linear.mean()) == pytest.approx(float(mean), rel=0.02)
    assert math.isfinite(float(linear.sum()))


@pytest.mark.parametrize("pixels", [208, 256, 400])
def test_the_finest_texture_is_kept(pixels):
    """Waves of 2.7 texels, by more pixels than texels, tilted: a texel's mean, not blurred more."""
    waves, detail, rows = 48.0, 128, pixels * 3 // 4
    setup = a_setup(tilt=(0.02, 0.03))
    columns = (np.arange(8 * pixels) + 0.5) / (8 * pixels)
    fine = np.sin(2.0 * np.pi * waves * columns).reshape(pixels, 8).mean(1)
    picture = np.repeat(np.tile(1.0 + 0.5 * fine, (rows, 1))[..., None], 3, axis=2)
    linear, _ = rectify(photo_of(picture), setup, detail)
    kept = float(linear[0, 32:-32, 32:-32].std()) / float(0.5 / 2.0**0.5)
    assert kept > 0.85 * np.sinc(waves / detail) * np.sinc(waves / pixels)


def photographed(burnt: bool):
    """Faint texture; with a burnt half whose texels flicker far above the rest."""
    generator = torch.Generator().manual_seed(0)
    linear = 0.1 * torch.exp(0.05 * torch.randn(3, 96, 256, generator=generator))
    valid = torch.ones(96, 256, dtype=torch.bool)
    if burnt:
        checks = (torch.arange(96)[:, None] + torch.arange(128)) % 2
        linear[:, :, 128:] = 0.5 + 0.5 * checks
        valid[:, 128:] = False
    return linear, valid


def test_clipped_texels_do_not_decide_the_encoding():
    """Neither of what middle grey is, nor of how much the texture varies."""
    sound, burnt = (plane_of(*photographed(with_burnt)) for with_burnt in (False, True))
    assert burnt.encoding.median == float(sound.linear[:, :, :128].mean(0).median())
    # Away from the border, where shading's means reach over it.
    for plane in (sound, burnt):
        assert 0.5 < float(plane.encoded()[:, :, :64].std()) < 1.5


def test_the_encoding_without_valid_texels_uses_all():
    linear, valid = photographed(burnt=True)
    plane = plane_of(linear, torch.zeros_like(valid))
    assert plane.encoding.median == float(linear.mean(0).median())


# Crop and mask: what is none of the material is not measured, and the geometry stays.


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
    width, height = photo.original_size
    beside = labelled(photo, slice(None), slice(WIDTH - 60, None))
    found = leave_out(beside, Rectangle(0, 0, width - 60, height), None)
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
    hue, clean_hue = (one.diffuse[0] / one.diffuse[2] for one in (fit, clean))
    assert hue == pytest.approx(clean_hue, rel=0.02)


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
def test_an_impossible_crop_is_refused(photo, crop, says):
    with pytest.raises(UsageError, match=says):
        leave_out(photo, crop, None)


def test_a_mask_of_another_size_is_refused(photo, tmp_path):
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


def test_crop_and_mask_are_stored_only_where_given(tmp_path):
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
    crop = border_crop(replace(edged, turned=True, original_size=(HEIGHT, WIDTH)))
    assert (crop.y, crop.height) == (0, WIDTH) and 14 <= crop.x <= 22
    result = [found for found in inspect_photo(edged).findings if found.name == "crop"]
    assert "--crop 0,0," in result[0].remedy
    assert not any(found.name == "crop" for found in inspect_photo(photo).findings)
    spotted = photo.pixels * (1.0 + 0.4 * (np.indices((HEIGHT, WIDTH)).sum(0) // 8 % 2))[..., None]
    assert border_crop(replace(photo, pixels=spotted.astype(np.float32))) is None


def test_texels_outside_of_a_tilted_photograph_are_left_out():
    setup = a_setup(tilt=(0.2, -0.1))
    plane = read_plane(photograph(setup), setup, WIDTH)
    shown = torch.from_numpy(inside((HEIGHT, WIDTH), setup))
    assert not shown.all() and bool((plane.kept == shown).all())
    assert not plane.valid[~shown].any() and not plane.measured[:, ~shown].any()
    straight = a_setup()
    assert read_plane(photograph(straight), straight, WIDTH).left_out is None


def test_the_largest_rectangle_has_only_kept_pixels():
    kept = np.ones((96, 131), bool)
    assert largest_rectangle(kept) == (slice(0, 96), slice(0, 131))
    kept[:20, :20] = kept[90:] = kept[:, 120:] = False
    assert largest_rectangle(kept) == (slice(0, 90), slice(20, 120))
    y, x = np.mgrid[:768, :1024]
    slanting = x > 60 + 0.1 * y
    rows, columns = largest_rectangle(slanting)
    assert slanting[rows, columns].all() and slanting[rows, columns].sum() > 0.9 * slanting.sum()
    assert largest_rectangle(np.zeros((64, 64), bool)) == (slice(0, 0), slice(0, 0))
