"""Rectification, tilt and portraits of a capture."""

import json
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from materials import quick_maps
from PIL import Image
from simulated.files import write_jpeg
from simulated.materials import piece
from simulated.photographs import Hand, PhoneCamera, as_photo, hold, noisy, take, take_several

from matcap.api import relight
from matcap.brdf.folder import read_mapset
from matcap.brdf.maps import MapSet
from matcap.capture import preview, rectified
from matcap.capture.inspection import inspect_file
from matcap.capture.rectified import (
    coarse_share,
    fit_photograph,
    lattice_of,
    network_input,
    tilt_document,
)
from matcap.capture.report import OutputSettings, write_outputs
from matcap.capture.run import capture_file, capture_into
from matcap.capture.settings import DETAIL, CaptureSettings
from matcap.field.material import Material
from matcap.field.opened import open_photographed
from matcap.flash.coarse.fit import fit_coarse
from matcap.flash.coarse.problem import TiltPrior
from matcap.flash.geometry import FlashSetup, Margins
from matcap.flash.rectify import plane_of
from matcap.relight.scene import Film
from matcap.relight.scenefile import photographed_scene
from matcap.statistics.lattice import Lattice, Wave

# Coarse textures are captured with half the texels; previews render some of large maps.


HEIGHT = 768


def noise(scale, contrast=0.3, seed=0):
    """(3, H, W) grey light whose log varies over about so many texels."""
    white = np.random.default_rng(seed).standard_normal((HEIGHT, DETAIL)).astype(np.float32)
    smooth = cv2.GaussianBlur(white, (0, 0), scale)
    light = 0.2 * np.exp(contrast * smooth / smooth.std())
    return torch.from_numpy(light).expand(3, -1, -1)


SEEN = torch.ones(HEIGHT, DETAIL, dtype=torch.bool)


@pytest.mark.parametrize(
    ("scale", "detail"), [(1, 1024), (3, 1024), (4, 1024), (20, 512), (30, 512)]
)
def test_blotches_too_large_for_the_network_halve_the_detail(scale, detail):
    assert network_input(plane_of(noise(scale), SEEN)).size[0] == detail


def test_the_share_grows_with_the_size_and_neither_with_contrast_nor_exposure():
    shares = [coarse_share(noise(scale), SEEN) for scale in (2, 5, 10, 20)]
    assert shares == sorted(shares) and 0.0 <= shares[0] < shares[-1] <= 1.0
    strong = coarse_share(7.0 * noise(10, contrast=0.6), SEEN)
    assert strong == pytest.approx(shares[2], abs=0.02)


def test_the_flash_alone_is_not_a_coarse_texture():
    """Shading and highlight are far wider than what is counted."""
    x, y = torch.linspace(-1, 1, DETAIL), torch.linspace(-0.75, 0.75, HEIGHT)[:, None]
    squared = x.square() + y.square()
    lit = noise(2) * (1.2**2 / (1.2**2 + squared)) ** 2 + 0.3 * torch.exp(-squared / 0.08)
    assert network_input(plane_of(lit, SEEN)).size[0] == DETAIL


@pytest.mark.parametrize(("share", "period"), [(0.7, 88.0), (0.4, 173.0)])
def test_a_lattice_of_half_the_picture_is_used_if_most_lies_on_it(monkeypatch, share, period):
    """As of gingham 0264_0869, of which the whole picture shows 173 texels for 88."""
    found = {DETAIL: Lattice((Wave(0.0, 1 / 173),), 0.1), 512: Lattice((Wave(0.0, 1 / 44),), share)}
    monkeypatch.setattr(rectified, "find_lattice", lambda colour, _valid: found[colour.shape[2]])
    (wave,) = lattice_of(plane_of(noise(2), SEEN, None))
    assert wave == pytest.approx((0.0, 1 / period))


def test_unseen_texels_do_not_count():
    picture, seen = noise(2).clone(), SEEN.clone()
    picture[:, 200:500, 300:700] = 30.0
    seen[200:500, 300:700] = False
    assert coarse_share(picture, seen) == pytest.approx(coarse_share(noise(2), SEEN), abs=0.02)
    assert coarse_share(picture, torch.zeros_like(seen)) == 0.0
    assert coarse_share(torch.full((3, HEIGHT, DETAIL), 0.2), SEEN) == 0.0


def test_panels_are_area_averages(monkeypatch):
    torch.manual_seed(0)
    one = torch.ones(1, 320, 640)
    rough = torch.rand(1, 1, 40, 80)
    bumps = torch.nn.functional.interpolate(rough, size=(320, 640), mode="bicubic")
    maps = MapSet(one.expand(3, -1, -1) * 0.3, 0.04 * one, 0.5 * one, 0.01 * bumps[0], 2 / 640)
    panels = []
    for texels in (160, 640):
        monkeypatch.setattr(preview, "LIT", texels)
        panels.append(preview.relit("left", maps, np.ones((2, 2, 3), np.float32), FlashSetup()))
    some, every = panels
    assert some.values.shape == (80, 160, 3) and every.values.shape == (320, 640, 3)
    codes = [np.asarray(panel.resized((32, 16)), float) for panel in panels]
    assert np.abs(codes[0] - codes[1]).mean() < 2.0 < codes[1].std()
    crops = [np.asarray(panel.crop(), float) for panel in panels]
    assert np.abs(crops[0] - crops[1]).max() <= 2.0


# Captures and inspections take the alignment branch's angles as a measurement, and say so.


TILTED = tuple(
    (name, (0.2 * math.cos(angle), 0.2 * math.sin(angle)))
    for angle, name in enumerate(("leather", "granite", "rust"))
)
SAID = TiltPrior((math.radians(9.0), math.radians(-6.0)), (1e-4, 1e-4))


@pytest.fixture
def asked(monkeypatch):
    """A branch that is certain of 9 and -6 degrees, and the photographs it was asked of."""
    names = []

    def measure(photo):
        names.append(photo.name)
        return SAID

    monkeypatch.setattr("matcap.capture.rectified.tilt_measurement", measure)
    return names


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    """Two photographs of one piece."""
    folder = tmp_path_factory.mktemp("photographs")
    phone = PhoneCamera(width=480, height=360, supersampling=1)
    hand = Hand()
    shots = take_several(piece("tile"), phone, hold(phone, hand, 2, 3), hand, 3)
    for index, held in enumerate(shots):
        write_jpeg(folder / f"tile_{index}.jpg", held, index)
    return sorted(folder.glob("tile_*.jpg"))


@pytest.mark.capture
def test_a_capture_uses_the_tilt_of_the_alignment_branch(tmp_path, photos, asked):
    settings = CaptureSettings(preset="draft", detail=160)
    capture_into(tmp_path / "out", photos[:1], settings, OutputSettings((32, 32)))
    assert asked == [photos[0].name]
    camera = json.loads((tmp_path / "out" / "report.json").read_text())["camera"]
    values = camera["tilt_sources"]
    assert values["branch"] == [9.0, -6.0] and values["used"] == pytest.approx([9.0, -6.0], abs=0.3)
    assert camera["tilt_degrees"] == pytest.approx(values["used"], abs=0.01)


def test_inspect_uses_the_alignment_branch(photos, asked):
    seen = inspect_file(photos[0], 320)
    assert asked == [photos[0].name]
    assert seen.tilt is not None and seen.tilt["branch"] == [9.0, -6.0]
    value = seen.quality["tilt"].value
    assert (value["up"], value["right"]) == pytest.approx((9.0, 6.0), abs=0.4)


@pytest.fixture(scope="module")
def fitted():
    """True tilts, and fits without and with the branch, of RAW photographs of a known flash."""
    found, phone = [], PhoneCamera(width=320, height=240, supersampling=1)
    for name, truth in TILTED:
        setup = FlashSetup(offset=(0.03, 0.12, 0.0), tilt=truth)
        photo = as_photo(take(piece(name), phone, setup), 1, name)
        photo = replace(photo, flash_intensity=3.0)
        found.append((truth, fit_coarse(photo), fit_photograph(photo)))
    return found


def test_the_shipped_branch_reduces_the_tilt_error(fitted):
    """With a sign turned, or the branch not asked, fits are no nearer."""
    alone, measured = (
        sum(math.dist(fits[which].setup.tilt, fits[0]) for fits in fitted) for which in (1, 2)
    )
    assert measured < alone


def test_without_a_tilt_measurement_the_report_has_none(fitted):
    assert tilt_document(fitted[0][1]) is None


def test_a_known_flash_keeps_its_intensity(fitted):
    assert fitted[0][2].setup.intensity == (3.0,) * 3


# A portrait photograph gives portrait maps, upright as it is looked at.


SETUP = FlashSetup(offset=(0.12, 0.05, 0.0), tilt=(0.05, -0.08))
CAMERA = PhoneCamera(width=240, height=180, supersampling=1)


def slanted(width, height, texel):
    """Stripes of albedo that lie neither across nor along, brighter to the right and below."""
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    x, y = (x - width / 2) * texel, (y - height / 2) * texel
    wave = 0.3 + 0.12 * torch.sin(25.0 * (x + 0.45 * y)) + 0.08 * x + 0.05 * y
    diffuse = wave.clamp(0.05, 0.9)[None].expand(3, -1, -1).double()
    one = torch.ones(1, height, width, dtype=torch.float64)
    return MapSet(diffuse, 0.04 * one, 0.6 * one, 0.0 * one, texel)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """The same picture as a landscape, and as a portrait that is stored on its side."""
    folder = tmp_path_factory.mktemp("portrait")
    light = noisy(take(slanted, CAMERA, SETUP).linear, CAMERA, 1)
    codes = np.rint(255 * np.clip(light, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    turned = Image.Exif()
    turned[0x0112] = 6  # to be turned a quarter clockwise
    Image.fromarray(codes).save(folder / "lying.png")
    Image.fromarray(codes).save(folder / "standing.png", exif=turned)
    return {name: folder / f"{name}.png" for name in ("lying", "standing")}


@pytest.fixture(scope="module")
def captures(photographs, one_coarse_fit):
    settings = CaptureSettings(preset="draft", detail=128, aligned=True)
    return {name: capture_file(path, settings) for name, path in photographs.items()}


@pytest.mark.capture
@pytest.mark.usefixtures("one_coarse_fit")
def test_a_portrait_decoder_field_is_the_landscape_one_rotated(photographs, tmp_path):
    """Across blocks of the grid, where it repeats too, and read from its file."""
    one_step = {"generator": "decoder", "steps": 1}
    settings = CaptureSettings(preset="draft", detail=128, aligned=True, **one_step)
    done = {name: capture_file(path, settings) for name, path in photographs.items()}
    lying, standing = done["lying"], done["standing"]
    assert standing.maps.size == (96, 128) == standing.rectified.shape[1::-1]
    assert torch.equal(standing.material.maps(96, 128).stacked(), standing.maps.stacked())
    assert "matching" not in standing.stage_seconds  # as it is a draft
    stood, lain = (one.estimate.exemplar.diffuse for one in (standing, lying))
    np.testing.assert_array_equal(stood, np.rot90(lain, -1, (1, 2)))
    standing.material.save(tmp_path / "standing.matcap")
    read = Material.load(tmp_path / "standing.matcap")
    for material, period in ((standing.material, None), (read, (128, 96))):
        place = {"x": -30, "y": -17 - 60, "period": period and period[::-1]}
        turned = quick_maps(lying.material, 80, 60, seed=5, **place).turned(-1)
        maps = quick_maps(material, 60, 80, seed=5, x=17, y=-30, period=period)
        assert torch.equal(maps.stacked(), turned.stacked())


@pytest.mark.capture
def test_a_portrait_exemplar_is_the_landscape_one_rotated(captures):
    lying, standing = (captures[name].estimate.exemplar for name in ("lying", "standing"))
    assert standing.size == lying.size[::-1] and standing.size[0] < standing.size[1]
    for name in ("diffuse", "roughness", "height", "confidence"):
        expected = np.rot90(getattr(lying, name), -1, (1, 2))
        np.testing.assert_array_equal(getattr(standing, name), expected)
    assert not captures["lying"].material.setup.turned


@pytest.mark.capture
def test_field_preview_and_maps_of_a_portrait_are_upright(captures):
    """The field's stripes run as the upright photograph's: seen by the phase of the gradient."""
    standing = captures["standing"]
    assert standing.maps.size == (96, 128) == standing.rectified.shape[1::-1]
    assert standing.rerendered.shape == standing.rectified.shape
    np.testing.assert_array_equal(standing.rectified, np.rot90(captures["lying"].rectified, -1))
    whole = standing.material.maps(128, 128, seed=3).diffuse.mean(0).numpy()
    # The border has texels that the tilted photograph does not show, which are black.
    seen = standing.rectified.mean(-1)[12:-12, 12:-12]
    assert seen.min() > 0.0 and slant(whole) == pytest.approx(slant(seen), abs=0.2)
    assert slant(standing.rerendered.mean(-1)) == pytest.approx(slant(whole), abs=0.2)
    lain = captures["lying"].material.maps(128, 128, seed=3).diffuse.mean(0).numpy()
    assert abs(slant(lain) - slant(whole)) > 1.0


def slant(picture: np.ndarray) -> float:
    """Direction of the steepest change, radians in [0, pi), by the structure tensor."""
    down, across = np.gradient(np.log(picture + 1e-3))
    return 0.5 * np.arctan2(2 * (across * down).mean(), (across**2 - down**2).mean()) % np.pi


@pytest.fixture(scope="module")
def written(captures, tmp_path_factory):
    folder = tmp_path_factory.mktemp("outputs") / "standing"
    write_outputs(captures["standing"], folder, OutputSettings((128, 128)))
    return folder


@pytest.mark.capture
def test_written_files_of_a_portrait_are_upright(captures, written):
    piece, document = read_mapset(written / "standing_photo.json")
    assert piece.size == (96, 128) and document["provenance"]["setup"]["turned"] is True
    assert Material.load(written / "standing.matcap").setup.turned
    assert np.asarray(Image.open(written / "preview.png")).shape[0] > 1000


@pytest.mark.capture
@pytest.mark.parametrize("of", ["standing.matcap", "standing_photo.json"])
def test_under_its_own_flash_a_portrait_looks_like_the_photograph(captures, written, of):
    """The camera stands, too: the picture is that of the piece re-rendered, not turned."""
    known = open_photographed(written / of)
    assert known.size == (96, 128)
    scene = photographed_scene(known.setup, Film(96, 128), endless=False)
    seen = relight(captures["standing"].estimate.example.piece(), scene).mean(-1)
    lying = captures["standing"].photo.pixels
    photograph = cv2.resize(np.rot90(lying, -1), (96, 128), interpolation=cv2.INTER_AREA).mean(-1)
    assert alike(seen, photograph) > 0.9
    assert alike(seen[::-1, ::-1], photograph) < 0.7 and alike(seen[:, ::-1], photograph) < 0.7


def alike(one: np.ndarray, other: np.ndarray) -> float:
    """Correlation of log light, but at the border."""
    inner = np.s_[12:-12, 12:-12]
    return np.corrcoef(*(np.log(p[inner] + 1e-3).ravel() for p in (one, other)))[0, 1]


def test_rotated_maps_rotate_their_normals():
    torch.manual_seed(0)
    one = torch.rand(1, 6, 8, dtype=torch.float64)
    maps = MapSet(one.expand(3, -1, -1), one, one, one, 0.25, periodic=True)
    painted = replace(maps, painted=maps.normal)
    for quarters in (1, 2, 3, -1):
        turned = painted.turned(quarters)
        torch.testing.assert_close(turned.painted, maps.turned(quarters).normal)
    torch.testing.assert_close(maps.turned(1).turned(-1).height, maps.height)


def test_margins_rotate_with_the_exemplar():
    piece = np.zeros((2 + 5 + 3, 1 + 7 + 4))
    margins = Margins(left=1, right=4, top=2, bottom=3)
    piece[margins.inside((7, 5))] = 1.0
    turned = np.zeros(piece.shape[::-1])
    turned[margins.turned().inside((5, 7))] = 1.0
    np.testing.assert_array_equal(turned, np.rot90(piece, -1))
