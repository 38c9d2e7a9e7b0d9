"""Simulated photographs, their files, and map sets that are photographed."""

import dataclasses
import filecmp
import json
import math
import struct
from dataclasses import replace

import cv2
import exifread
import numpy as np
import pytest
import rawpy
import tifffile
import torch
from PIL import Image

from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError
from matcap.flash.geometry import FlashSetup, plane_points, project
from matcap.flash.light import render_rectified
from matcap.flash.rectify import rectify
from matcap.photo.load import load_photo
from matcap.photo.photo import WITH_GAIN_MAP
from matcap_lab.simulate.files import gain_map, write_dng, write_gain_map_jpeg, write_jpeg
from matcap_lab.simulate.hand_held import FORMS, PhonePhotographs
from matcap_lab.simulate.photograph import PhoneCamera, Shot, as_photo, expose, take, true_maps
from matcap_lab.simulate.specimen import EXAMPLES, Specimen, map_set_folders, read_map_set

CAMERA = PhoneCamera(width=128, height=96)


def _flat(width, height, texel_size):
    """Uniform matte grey: its photograph has a closed form."""
    full = torch.ones(1, height, width, dtype=torch.float64)
    return MapSet(0.4 * full.expand(3, -1, -1), 0.04 * full, 0.9 * full, 0 * full, texel_size)


def test_untilted_photograph_is_the_renderer_s():
    setup = FlashSetup(offset=(0.1, 0.05, 0.0))
    shot = take(_flat, CAMERA, setup)
    truth = render_rectified(true_maps(_flat, CAMERA, setup), shot.setup)
    # The lens's blur has less to draw on at the border.
    inner = slice(2, -2)
    expected = truth.permute(1, 2, 0).numpy()[inner, inner]
    np.testing.assert_allclose(shot.linear[inner, inner], expected, rtol=2e-3)


def test_tilt_moves_points_to_where_they_project():
    """A bright dot on the plane is found in the picture where geometry says."""
    setup = FlashSetup(tilt=(math.radians(6.0), math.radians(-4.0)))

    def dot(width, height, texel_size):
        maps = _flat(width, height, texel_size)
        x = (torch.arange(width) + 0.5 - width / 2) * texel_size
        y = (height / 2 - 0.5 - torch.arange(height)) * texel_size
        near = (x[None, :] - 0.7).square() + (y[:, None] + 0.5).square() < 0.02**2
        return MapSet(
            torch.where(near, 0.9, 0.01).expand(3, -1, -1).double(),
            maps.specular,
            maps.roughness,
            maps.height,
            texel_size,
        )

    shot = take(dot, PhoneCamera(width=256, height=192), setup)
    weight = np.where(shot.linear[..., 0] > 0.5 * shot.linear.max(), shot.linear[..., 0], 0.0)
    rows, columns = np.mgrid[0:192, 0:256]
    found = (
        ((columns + 0.5) * weight).sum() / weight.sum() / 128 - 1.0,
        (96.0 - (rows * weight).sum() / weight.sum() - 0.5) / 128,
    )
    place = torch.tensor([0.7, -0.5, 0.0], dtype=torch.float64)[:, None]
    expected = project(place, shot.setup)[:, 0]
    np.testing.assert_allclose(found, expected.numpy(), atol=0.004)


def test_strips_do_not_show():
    """Shading goes by strips of rows; normals at their borders must be those of the whole."""
    setup = FlashSetup(offset=(0.1, 0.0, 0.0))
    camera = PhoneCamera(width=128, height=96, supersampling=1, blur=0.01)
    piece = EXAMPLES["leather"].pieces(1)
    shot = take(piece, camera, setup)
    whole = render_rectified(true_maps(piece, camera, setup), shot.setup)
    inner = slice(2, -2)
    np.testing.assert_allclose(
        shot.linear[inner, inner], whole.permute(1, 2, 0).numpy()[inner, inner], rtol=1e-3
    )


@pytest.mark.parametrize("name", ["leather", "granite", "rust", "tile"])
def test_exposure_clips_a_little_on_glossy_ones(name):
    photo = as_photo(EXAMPLES[name].take(PhoneCamera(width=256, height=192)), 0, name)
    assert 0.0 < photo.clipped_share < 0.03
    assert photo.radiometric and photo.flash_fired
    assert photo.pixels.max() <= 1.0 and np.isfinite(photo.pixels).all()


def test_noise_is_shot_and_read_noise():
    shot = take(
        _flat, PhoneCamera(width=128, height=96, full_well=1000.0, read_noise=5.0), FlashSetup()
    )
    error = expose(shot, 1) - shot.linear
    expected = np.sqrt(shot.linear.mean() / 1000.0 + 0.005**2)
    assert error.std() == pytest.approx(expected, rel=0.03)
    assert abs(error.mean()) < 3e-4


def test_true_maps_lie_on_the_plane_grid():
    """A detail of the truth and of the photograph are in one place, also when tilted."""
    example = EXAMPLES["granite"]
    camera = PhoneCamera(width=256, height=192)
    shot, truth = example.take(camera), example.truth(camera)
    assert truth.size == (256, 192)
    points = plane_points(0, 0, 256, 192, (256, 192), dtype=torch.float64)
    image = project(points, shot.setup).numpy()
    column = np.clip(np.round((image[0] + 1) * 128 - 0.5).astype(int), 0, 255)
    row = np.clip(np.round(96 - image[1] * 128 - 0.5).astype(int), 0, 191)
    photographed = shot.linear[row, column].mean(-1)
    rendered = render_rectified(truth, shot.setup).mean(0).numpy()
    inner = slice(8, -8)

    def agreement(dx):
        moved = np.roll(photographed, dx, axis=1)
        return np.corrcoef(moved[inner, inner].ravel(), rendered[inner, inner].ravel())[0, 1]

    assert agreement(0) > 0.8
    assert agreement(0) > max(agreement(2), agreement(-2)) + 0.1


def test_true_maps_are_of_the_piece_that_was_photographed():
    """Granite's grains are others at another fineness; its truth must be what the camera saw."""
    camera, example = PhoneCamera(width=240, height=180), EXAMPLES["granite"]
    shot = example.take(camera)
    seen, _ = rectify(as_photo(shot, 0, "granite"), shot.setup, camera.width)
    true = render_rectified(example.truth(camera).map(lambda m: m.float()), shot.setup)
    pictures = torch.stack([p.clamp_min(1e-3).log().mean(0).flatten() for p in (seen, true)])
    assert float(torch.corrcoef(pictures)[0, 1]) > 0.8  # the lens blurs; another piece has 0.74


SMALL = PhoneCamera(96, 72, supersampling=1)


def test_a_material_is_photographed_in_the_same_way_at_every_time_and_others_otherwise():
    rust, tile = (PhonePhotographs.of(EXAMPLES[name], SMALL) for name in ("rust", "tile"))
    again = PhonePhotographs.of(EXAMPLES["rust"], SMALL)
    assert (rust.phone, rust.hand, rust.tilt) == (again.phone, again.hand, again.tilt)
    assert rust.phone != tile.phone and rust.tilt != tile.tilt


def named(name, material=EXAMPLES["plaster"].material):
    return replace(EXAMPLES["plaster"], name=name, material=material)


def test_exposures_are_those_of_real_photographs():
    phones = [PhonePhotographs.of(named(f"plaster {number}"), SMALL).phone for number in range(400)]
    brightness = np.quantile([phone.brightness for phone in phones], (0.05, 0.5, 0.95))
    assert brightness == pytest.approx([0.075, 0.133, 0.236], rel=0.15)
    clipped = [phone.clipped for phone in phones]
    assert np.median(clipped) == pytest.approx(0.0, abs=1e-4) and max(clipped) <= 0.02


def test_from_further_away_slopes_stay_and_more_is_seen():
    pieces, asked = named("").pieces, []

    def spy(width, height, seed, texel_size):
        asked.append(texel_size)
        return pieces(seed)(width, height, texel_size)

    maps = PhonePhotographs.of(named("far", spy), SMALL).specimen.pieces(3)(32, 32, 0.01)
    (texel,) = asked
    assert 0.5**0.5 <= texel / 0.01 <= 2.0**0.5 and texel != 0.01
    assert maps.texel_size == 0.01
    assert torch.allclose(maps.normal, pieces(3)(32, 32, texel).normal, atol=1e-6)


def test_photographs_are_taken_once_and_their_truth_is_kept(tmp_path):
    held = PhonePhotographs.of(EXAMPLES["plaster"], SMALL)
    files, setup = held.take(2, tmp_path)
    assert tuple(files) == FORMS
    assert [path.name for path in files["DNG"]] == ["plaster_0.dng", "plaster_1.dng"]
    written = files["DNG"][0].stat().st_mtime_ns
    again, same = held.take(2, tmp_path)
    assert again == files and same == setup
    assert files["DNG"][0].stat().st_mtime_ns == written
    more, _ = held.take(3, tmp_path)
    assert len(more["DNG"]) == 3 and all(path.exists() for each in more.values() for path in each)
    mean = float(load_photo(files["DNG"][0], noise=False).pixels.mean())
    assert mean <= held.phone.brightness * 1.1
    assert setup.tilt == held.tilt and setup.intensity[0] > 0.0
    bright, dark = (load_photo(path, noise=False) for path in files["JPEG, two exposures"])
    assert bright.exposure == pytest.approx(4.0 * dark.exposure, rel=1e-3)
    (toned,) = files["JPEG, gain map"]
    assert load_photo(toned, noise=False).development == WITH_GAIN_MAP


def test_a_gain_map_undoes_local_toning(tmp_path):
    linear = np.full((192, 256, 3), 0.25)
    linear[:, 128:192], linear[:, 192:] = 2.0, 5.0
    phone = PhoneCamera(256, 192)
    write_gain_map_jpeg(tmp_path / "a.jpg", Shot(linear, FlashSetup(fov=phone.fov), phone), 1)
    seen = load_photo(tmp_path / "a.jpg", noise=False).pixels[96].mean(axis=-1)
    np.testing.assert_allclose(seen[[40, 160, 230]], (0.25, 2.0, 5.0), rtol=0.05)


SMALL_CAMERA = PhoneCamera(width=240, height=180)


@pytest.fixture
def shot():
    """Smooth and colourful, so that demosaicing is nearly exact and mixed-up channels show."""
    y, x = np.mgrid[0:180, 0:240] / 240
    linear = np.stack([0.15 + 0.4 * x, 0.12 + 0.4 * y, 0.08 + 0.2 * (x + y)], axis=-1)
    return Shot(linear, FlashSetup(fov=SMALL_CAMERA.fov), SMALL_CAMERA)


def _develop(path):
    with rawpy.imread(str(path)) as raw:
        return (
            raw.postprocess(
                gamma=(1, 1),
                no_auto_bright=True,
                output_bps=16,
                use_camera_wb=True,
                adjust_maximum_thr=0,
            )
            / 65535.0
        )


def _write(path, shot, seed):
    write = write_dng if path.suffix == ".dng" else write_jpeg
    write(path, shot, seed)
    return path


def test_dng_develops_to_the_truth_within_noise(shot, tmp_path):
    write_dng(tmp_path / "a.dng", shot, seed=1)
    error = (_develop(tmp_path / "a.dng") - shot.linear)[4:-4, 4:-4]
    # Without bias, and no noisier than a sensor of this well: the matrix amplifies red and blue.
    np.testing.assert_allclose(error.mean((0, 1)), 0.0, atol=5e-4)
    assert error.std() < 3.0 * np.sqrt(shot.linear.mean() / SMALL_CAMERA.full_well)


def test_dng_clips_white(tmp_path):
    white = Shot(np.full((180, 240, 3), 3.0), FlashSetup(), SMALL_CAMERA)
    write_dng(tmp_path / "a.dng", white, seed=1)
    np.testing.assert_allclose(_develop(tmp_path / "a.dng"), 1.0, atol=2e-3)


@pytest.mark.parametrize("suffix", ["dng", "jpg"])
def test_exif_is_readable(shot, tmp_path, suffix):
    path = _write(tmp_path / f"a.{suffix}", shot, 1)
    with path.open("rb") as stream:
        tags = exifread.process_file(stream, details=False)
    # 28 mm across the long side of 36 are 27 by the diagonal of 4:3.
    assert tags["EXIF FocalLengthIn35mmFilm"].values == [27]
    assert load_photo(path).fov == pytest.approx(SMALL_CAMERA.fov, abs=1e-3)
    assert tags["EXIF Flash"].values[0] & 1
    assert tags["Image Orientation"].values == [1]
    assert str(tags["Image Make"]) == "matcap"
    assert float(tags["EXIF ExposureTime"].values[0]) == pytest.approx(1 / 60)


def test_gain_map_undoes_the_shading(shot, tmp_path):
    grey = dataclasses.replace(shot, linear=np.full((180, 240, 3), 0.3))
    write_dng(tmp_path / "a.dng", grey, seed=1, shading=0.5)
    developed = _develop(tmp_path / "a.dng")
    assert developed[:20, :20].mean() / developed[80:100, 110:130].mean() < 0.65
    with tifffile.TiffFile(tmp_path / "a.dng") as tiff:
        opcodes = tiff.pages.first.tags[51009].value
    assert struct.unpack(">L", opcodes[:4]) == (4,)
    number, _, _, size = struct.unpack(">L4sLL", opcodes[4:20])
    assert number == 9
    head = struct.unpack(">10L4dL", opcodes[20 : 20 + 40 + 32 + 4])
    assert head[:10] == (0, 0, 180, 240, 0, 1, 2, 2, 13, 17)
    gains = np.frombuffer(opcodes[20 + 76 : 20 + size], ">f4").reshape(13, 17)
    np.testing.assert_array_equal(gains, gain_map(0.5))
    # Nearest of 13 x 17 points is enough to flatten the picture to a few per cent.
    rows = np.round((np.arange(180) + 0.5) / 180 * 12).astype(int)
    columns = np.round((np.arange(240) + 0.5) / 240 * 16).astype(int)
    flat = developed.mean(-1) * gains[rows[:, None], columns]
    np.testing.assert_allclose(flat.reshape(6, 30, 6, 40).mean((1, 3)), 0.3, rtol=0.03)


def test_dng_without_shading_has_no_opcodes(shot, tmp_path):
    write_dng(tmp_path / "a.dng", shot, seed=1)
    with tifffile.TiffFile(tmp_path / "a.dng") as tiff:
        assert 51009 not in tiff.pages.first.tags


@pytest.mark.parametrize("suffix", ["dng", "jpg"])
def test_files_are_reproducible(shot, tmp_path, suffix):
    files = [_write(tmp_path / f"{name}.{suffix}", shot, 5) for name in ("a", "b")]
    assert filecmp.cmp(*files, shallow=False)


def test_jpeg_shows_the_exposed_picture(shot, tmp_path):
    write_jpeg(tmp_path / "a.jpg", shot, seed=1)
    with Image.open(tmp_path / "a.jpg") as picture:
        code = np.asarray(picture, dtype=np.float64) / 255.0
    linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    assert np.abs(linear - expose(shot, 1)).mean() < 0.01
    np.testing.assert_allclose(linear.mean((0, 1)), shot.linear.mean((0, 1)), rtol=0.01)


def test_unwritable_place_is_one_sentence(shot, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(MatcapError):
        write_dng(tmp_path / "file" / "a.dng", shot, seed=1)


# Artists' map sets as materials, of tiny sets made here.

SIDE = 32
SLOPE = 0.5  # the steepest
BROWN = ((np.array([0.6, 0.4, 0.2]) + 0.055) / 1.055) ** 2.4  # the base colour, linear


@pytest.fixture
def waves(tmp_path):
    """Waves along y: a known relief with its normals, a brown colour, half of it metal."""
    return write_set(tmp_path / "waves", metal=True)


def write_set(folder, *, metal=False, side=SIDE):
    folder.mkdir()
    up = SLOPE * np.cos(2.0 * np.pi * -np.arange(side) / side)[:, None].repeat(side, 1)
    normal = np.stack([0.0 * up, -up, np.ones_like(up)]) / np.sqrt(1.0 + up**2)
    save(folder / "normal.png", np.moveaxis(normal, 0, 2) * 0.5 + 0.5)
    save(folder / "basecolor.jpg", np.ones((side, side, 3)) * (0.6, 0.4, 0.2))
    save(folder / "roughness.png", np.full((side, side), 0.3))
    if metal:
        save(folder / "metallic.png", np.arange(side)[None, :].repeat(side, 0) >= side // 2)
    return folder


def save(path, picture):
    code = np.round(np.asarray(picture, np.float64) * 255.0).astype(np.uint8)
    cv2.imwrite(str(path), code[..., ::-1] if code.ndim == 3 else code)


def test_relief_has_the_slopes_of_the_normal_map(waves):
    maps = read_map_set(waves).realise(64, 64, 0, 2.0 / 64)
    up = -maps.normal[1] / maps.normal[2]
    assert float(up.abs().max()) == pytest.approx(SLOPE, rel=0.05)
    rows = torch.arange(64) + 0.5 - 32.0
    expected = SLOPE * torch.cos(2.0 * torch.pi * (-(rows / 2.0 - 0.5)) / SIDE)
    assert torch.allclose(up[4:-4, 10].double(), expected[4:-4].double(), atol=0.03)


def test_metal_has_its_colour_in_f0_and_no_diffuse(waves):
    maps = read_map_set(waves).realise(SIDE, SIDE, 0, 2.0 / SIDE)
    columns = (np.arange(SIDE) - SIDE // 2) % SIDE
    plain, metal = maps.crop(0, 0, SIDE, SIDE), columns >= SIDE // 2
    inside = np.abs(columns - SIDE * 3 // 4) < SIDE // 8
    assert float(plain.diffuse[:, :, metal & inside].max()) < 0.01
    assert plain.specular[:, 0, inside].mean(1).numpy() == pytest.approx(BROWN, rel=0.1)
    outside = np.abs(columns - SIDE // 4) < SIDE // 8
    assert plain.specular[:, 0, outside].mean(1).numpy() == pytest.approx(0.04, abs=0.005)
    assert plain.diffuse[:, 0, outside].mean(1).numpy() == pytest.approx(BROWN, rel=0.1)


def test_it_goes_on_without_end_and_finer_shows_the_same_piece(waves):
    material = read_map_set(waves)
    wide = material.realise(4 * SIDE, SIDE, 3, 2.0 / SIDE)
    assert torch.allclose(wide.height[..., :SIDE], wide.height[..., SIDE : 2 * SIDE], atol=1e-5)
    fine = material.realise(4 * SIDE, 4 * SIDE, 3, 0.5 / SIDE)
    coarse = material.realise(SIDE, SIDE, 3, 2.0 / SIDE)
    again = torch.nn.functional.avg_pool2d(fine.height[None], 4)[0]
    assert torch.allclose(again, coarse.height, atol=0.02 * float(coarse.height.std()))
    other = material.realise(SIDE, SIDE, 4, 2.0 / SIDE)
    assert not torch.allclose(other.height, coarse.height, atol=1e-4)


def test_it_can_be_photographed(waves):
    specimen = Specimen("waves", read_map_set(waves).realise)
    shot = take(specimen.realise, PhoneCamera(64, 48), FlashSetup(offset=(0.1, 0.0, 0.0)))
    assert np.isfinite(shot.linear).all() and shot.linear.mean() > 0.01


def test_folders_are_listed_and_broken_ones_told(tmp_path, waves):
    write_set(tmp_path / "again")
    assert [f.name for f in map_set_folders(tmp_path)] == ["again", "waves"]
    save(waves / "roughness.png", np.zeros((8, 16)))
    with pytest.raises(MatcapError, match="another aspect ratio"):
        read_map_set(waves)
    (waves / "roughness.png").unlink()
    with pytest.raises(MatcapError, match="can be read"):
        read_map_set(waves)


def test_a_bare_metal_is_told_by_the_manifest(tmp_path):
    write_set(tmp_path / "plain")
    assert len(read_map_set(tmp_path / "plain").realise(32, 32, 0, 2.0 / 32).specular) == 1
    result = [{"name": "plain", "remarks": "no metallic map in the source: bare metal, take 1"}]
    (tmp_path / "manifest.json").write_text(json.dumps(result))
    maps = read_map_set(tmp_path / "plain").realise(32, 32, 0, 2.0 / 32)
    assert maps.specular.mean((1, 2)).numpy() == pytest.approx(BROWN, rel=0.1)
    assert float(maps.diffuse.max()) == 0.0
