"""NAME_preview.png: what is written, one pixel a texel, lit from the top, and where it repeats."""

import math

import numpy as np
import pytest
from PIL import Image

from matcap.brdf.folder import MapSetInfo, read_mapset, write_mapset
from matcap.field.plane import Rectangle
from matcap.relight.render import Renderer
from matcap.relight.scene import Camera, DirectionalLight, Film, Scene, Surface
from matcap.synth.preview import preview_of
from matcap.synth.request import SynthRequest, Work
from matcap.synth.synthesise import synthesise

DISTANCE = math.hypot(2.0, 1.2)


def rendered(maps):
    """What the renderer makes of maps from straight above, and how bright the preview shows it."""
    width, height = maps.size
    camera = Camera("orthographic", scale=max(maps.size) * maps.texel_size / 2)
    sun = DirectionalLight((0.0, 2.0, 1.2), (math.pi * DISTANCE / 1.2,) * 3)
    scene = Scene(Film(width, height), camera, Surface(size=None), (sun,))
    radiance = Renderer(maps, scene).render(effects="none,+diffuse,+specular").radiance
    radiance = np.clip(radiance, 0.0, 1.0)
    gain = np.clip(0.5 / np.quantile(radiance[::8, ::8], 0.99), 1.0, 4.0)
    light = np.clip(gain * radiance, 0.0, 1.0)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055) * 255.0


def written(material, folder, area, **asked):
    """The preview and the maps of a request."""
    document = synthesise(SynthRequest(material, area, **asked), folder)
    preview = document.with_name(f"{document.stem}_preview.png")
    return np.asarray(Image.open(preview)).astype(float), document


@pytest.mark.parametrize("normal", ["gl", "dx"])
def test_it_is_what_the_renderer_makes_of_the_maps(material, tmp_path, normal):
    shown, document = written(material, tmp_path, Rectangle(-20, 7, 90, 50), normal=normal)
    expected = rendered(read_mapset(document, "file")[0])
    assert shown.shape == expected.shape
    assert np.abs(shown - expected).max() < 2.0  # maps in the files are half floats
    assert expected.std() > 1.0


@pytest.mark.parametrize(("tile", "copies"), [("both", (2, 2)), ("x", (1, 2)), ("y", (2, 1))])
def test_copies_of_what_repeats_meet_in_its_middle(material, tmp_path, tile, copies):
    shown, document = written(material, tmp_path, Rectangle(5, 3, 48, 32), tile=tile)
    expected = np.tile(rendered(read_mapset(document, "file")[0]), (*copies, 1))
    inside = shown[16:-16, 16:-16]
    # The exposure is read from every eighth row and column, as those of copies are.
    assert np.abs(inside - expected).max() < 3.0
    ink = (shown == [240, 180, 41]).all(axis=2)
    (height, width), across, down = ink.shape, ink.any(axis=0), ink.any(axis=1)
    middle_x, middle_y = width // 2, height // 2
    assert ink[0, middle_x] == ink[-1, middle_x] == (tile != "y")
    assert ink[middle_y, 0] == ink[middle_y, -1] == (tile != "x")
    assert across[:middle_x].sum() == across[middle_x:].sum()
    assert down[:middle_y].sum() == down[middle_y:].sum()
    assert not ink[16:-16, 16:-16].any()


def test_a_texture_set_has_one_of_all_its_tiles(material, tmp_path):
    shown, _ = written(material, tmp_path / "set", Rectangle(0, 0, 32, 24), udim=(2, 2))
    whole, _ = written(material, tmp_path / "whole", Rectangle(0, 0, 64, 48))
    assert np.array_equal(shown, whole)


def test_none_is_written_where_none_is_asked_for_and_an_older_one_goes(material, tmp_path):
    area = Rectangle(0, 0, 16, 16)
    written(material, tmp_path, area)
    document = synthesise(SynthRequest(material, area, preview=False), tmp_path, Work())
    assert not list(tmp_path.glob("*.png")) and document.is_file()


@pytest.mark.parametrize(
    ("whole", "repeats", "shown"),
    [
        ((4096, 256), False, (0, 0, 4096, 256)),
        ((3072, 2304), False, (1024, 640, 1024, 1024)),
        ((2**30, 2**30), False, (2**29 - 512, 2**29 - 512, 1024, 1024)),
        ((2**30, 2**30), True, (-512, -512, 1024, 1024)),
        ((2**30, 1), False, (2**29 - 2**19, 0, 2**20, 1)),
        ((16, 2048), True, (-16, -512, 32, 1024)),
    ],
)
def test_about_a_megapixel_is_shown_of_any_size(whole, repeats, shown):
    area = Rectangle(7, -5, *whole)
    preview = preview_of(area, whole if repeats else None)
    x, y, width, height = shown
    assert preview.shown == Rectangle(7 + x, y - 5, width, height)
    assert preview.repeats == (repeats, repeats)


def test_maps_written_over_synthesised_ones_leave_no_preview_of_those(material, tmp_path):
    _, document = written(material, tmp_path, Rectangle(0, 0, 16, 16))
    write_mapset(material.maps(16, 16), tmp_path, MapSetInfo(document.stem))
    assert not list(tmp_path.glob("*_preview.png"))
