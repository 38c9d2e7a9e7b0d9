"""A portrait photograph gives portrait maps, upright as it is looked at."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from PIL import Image
from simulated.photographs import PhoneCamera, noisy, take

from matcap.brdf.folder import read_mapset
from matcap.brdf.maps import MapSet
from matcap.capture.outputs import OutputSettings, write_outputs
from matcap.capture.pipeline import capture_file
from matcap.capture.settings import CaptureSettings
from matcap.field.material import Material
from matcap.field.opened import open_photographed
from matcap.flash.extent import Margins
from matcap.flash.geometry import FlashSetup
from matcap.relight.photographed import photographed_scene
from matcap.relight.render import relight
from matcap.relight.scene import Film

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
def captures(photographs):
    settings = CaptureSettings(preset="draft", detail=192, aligned=True)
    return {name: capture_file(path, settings) for name, path in photographs.items()}


@pytest.mark.parametrize("drawing", [True, False])
def test_a_decoder_s_field_is_the_lying_one_turned(photographs, drawing, tmp_path):
    """Across blocks of the grid, where it repeats too, and read from its file."""
    settings = CaptureSettings(
        generator="decoder", preset="draft", detail=192, steps=1, drawing=drawing, aligned=True
    )
    done = {name: capture_file(path, settings) for name, path in photographs.items()}
    lying, standing = done["lying"], done["standing"]
    assert lying.verdict.document()["checks"]["steepness"]["value"] > 0.0
    assert standing.maps.size == (144, 192) == standing.rectified.shape[1::-1]
    np.testing.assert_array_equal(
        standing.estimate.exemplar.diffuse, np.rot90(lying.estimate.exemplar.diffuse, -1, (1, 2))
    )
    standing.material.save(tmp_path / "standing.matcap")
    read = Material.load(tmp_path / "standing.matcap")
    for period in (None, (128, 96)):
        turned = lying.material.maps(
            80, 60, seed=5, x=-30, y=-17 - 60, period=period and period[::-1]
        ).turned(-1)
        for material in (standing.material, read):
            maps = material.maps(60, 80, seed=5, x=17, y=-30, period=period)
            assert torch.equal(maps.stacked(), turned.stacked())


def test_the_piece_is_the_lying_one_turned(captures):
    lying, standing = (captures[name].estimate.exemplar for name in ("lying", "standing"))
    assert standing.size == lying.size[::-1] and standing.size[0] < standing.size[1]
    for name in ("diffuse", "roughness", "height", "confidence"):
        expected = np.rot90(getattr(lying, name), -1, (1, 2))
        np.testing.assert_array_equal(getattr(standing, name), expected)
    assert not captures["lying"].material.setup.turned


def test_field_preview_and_maps_stand(captures):
    """The field's stripes run as the upright photograph's: seen by the phase of the gradient."""
    standing = captures["standing"]
    assert standing.maps.size == (144, 192) == standing.rectified.shape[1::-1]
    assert standing.rerendered.shape == standing.rectified.shape
    expected = np.rot90(captures["lying"].rectified, -1)
    np.testing.assert_array_equal(standing.rectified, expected)
    whole = standing.material.maps(192, 192, seed=3).diffuse.mean(0).numpy()
    assert slant(whole) == pytest.approx(slant(standing.rectified.mean(-1)), abs=0.2)
    assert slant(standing.rerendered.mean(-1)) == pytest.approx(slant(whole), abs=0.2)
    lain = captures["lying"].material.maps(192, 192, seed=3).diffuse.mean(0).numpy()
    assert abs(slant(lain) - slant(whole)) > 1.0


def slant(picture: np.ndarray) -> float:
    """Direction of the steepest change, radians in [0, pi), by the structure tensor."""
    down, across = np.gradient(np.log(picture + 1e-3))
    return 0.5 * np.arctan2(2 * (across * down).mean(), (across**2 - down**2).mean()) % np.pi


@pytest.fixture(scope="module")
def written(captures, tmp_path_factory):
    folder = tmp_path_factory.mktemp("outputs") / "standing"
    write_outputs(captures["standing"], folder, OutputSettings((192, 192)))
    return folder


def test_what_is_written_stands(captures, written):
    piece, document = read_mapset(written / "standing_photo.json")
    assert piece.size == (144, 192)
    assert document["provenance"]["setup"]["turned"] is True
    assert Material.load(written / "standing.matcap").setup.turned
    sheet = np.asarray(Image.open(written / "preview.png"))
    assert sheet.shape[0] > 1000


@pytest.mark.parametrize("of", ["standing.matcap", "standing_photo.json"])
def test_by_its_own_flash_it_looks_like_the_photograph(captures, written, of):
    """The camera stands, too: the picture is that of the piece re-rendered, not turned."""
    known = open_photographed(written / of)
    assert known.size == (144, 192)
    scene = photographed_scene(known.setup, Film(144, 192), endless=False)
    seen = relight(captures["standing"].estimate.example.piece(), scene).mean(-1)
    lying = captures["standing"].photo.pixels
    photograph = cv2.resize(np.rot90(lying, -1), (144, 192), interpolation=cv2.INTER_AREA).mean(-1)
    assert alike(seen, photograph) > 0.9
    assert alike(seen[::-1, ::-1], photograph) < 0.7 and alike(seen[:, ::-1], photograph) < 0.7


def alike(one: np.ndarray, other: np.ndarray) -> float:
    """Correlation of log light, but at the border."""
    inner = np.s_[12:-12, 12:-12]
    return np.corrcoef(*(np.log(p[inner] + 1e-3).ravel() for p in (one, other)))[0, 1]


def test_maps_turn_with_their_normals():
    torch.manual_seed(0)
    one = torch.rand(1, 6, 8, dtype=torch.float64)
    maps = MapSet(one.expand(3, -1, -1), one, one, one, 0.25, periodic=True)
    painted = replace(maps, painted=maps.normal)
    for quarters in (1, 2, 3, -1):
        turned = painted.turned(quarters)
        torch.testing.assert_close(turned.painted, maps.turned(quarters).normal)
    torch.testing.assert_close(maps.turned(1).turned(-1).height, maps.height)


def test_margins_turn_with_their_piece():
    piece = np.zeros((2 + 5 + 3, 1 + 7 + 4))
    margins = Margins(left=1, right=4, top=2, bottom=3)
    piece[margins.inside((7, 5))] = 1.0
    turned = np.zeros(piece.shape[::-1])
    turned[margins.turned().inside((5, 7))] = 1.0
    np.testing.assert_array_equal(turned, np.rot90(piece, -1))
