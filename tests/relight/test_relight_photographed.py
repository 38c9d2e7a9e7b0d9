"""`--light flash` is the photograph again: matcap.flash.render's picture, from the same camera."""

import json
from dataclasses import asdict, replace

import cv2
import numpy as np
import pytest
import torch
from relight_samples import bumpy, flat
from simulated.photographs import PhoneCamera, take

from matcap.brdf.folder import PIECE, SETUP, MapSetInfo, write_mapset
from matcap.brdf.maps import MapSet
from matcap.cli.main import main
from matcap.files.exr import read_exr
from matcap.files.srgb import srgb_encode
from matcap.flash.geometry import FlashSetup, unproject
from matcap.flash.render import render_flash, render_rectified
from matcap.relight.effects.bound import DEFAULT_TOLERANCE
from matcap.relight.photographed import photographed_scene
from matcap.relight.render import Renderer
from matcap.relight.scene import Film

SETUP_OF_A_PHONE = FlashSetup(
    fov=64.0, offset=(0.1, -0.04, 0.02), intensity=(5.0, 4.0, 3.0), vignetting=0.4,
    vignetting_centre=(0.05, -0.2),
)  # fmt: skip
# What the flash renderer has, too.
SAME = "none,+diffuse,+specular,+falloff"


def relit(maps: MapSet, setup: FlashSetup, *, effects="auto", size=None):
    scene = photographed_scene(setup, Film(*(size or maps.size)), endless=False)
    return Renderer(maps, scene).render(effects=effects).radiance


@pytest.mark.parametrize("vignetting", [(0.4, 0.0), (0.0, 0.0), (-0.3, 0.0), (0.0, 0.9)])
def test_a_photograph_from_straight_above_is_rendered_alike(vignetting):
    maps = bumpy(64, 48, relief=0.02)
    first, second = vignetting
    setup = replace(SETUP_OF_A_PHONE, vignetting=first, vignetting_quartic=second)
    expected = render_rectified(maps, setup).movedim(0, -1).numpy()
    np.testing.assert_allclose(relit(maps, setup, effects=SAME), expected, rtol=2e-4)


@pytest.mark.parametrize("tilt", [(0.1, 0.0), (0.0, -0.12), (0.09, 0.13)])
@pytest.mark.parametrize("size", [(48, 36), (36, 48)])
def test_a_tilted_photograph_is_rendered_alike(tilt, size):
    setup = replace(SETUP_OF_A_PHONE, tilt=tilt)
    maps = flat(64, 64)
    scene = photographed_scene(setup, Film(*size), endless=True)
    found = Renderer(maps, scene).render(effects=SAME).radiance
    long = max(size)
    across = (torch.arange(size[0], dtype=torch.float64) * 2 + 1 - size[0]) / long
    down = (size[1] - 1 - torch.arange(size[1], dtype=torch.float64) * 2) / long
    image = torch.stack([across.expand(size[1], -1), down[:, None].expand(-1, size[0])])
    points = unproject(image, setup)
    expected = (
        render_flash(flat(*size).map(torch.Tensor.double), setup, points).movedim(0, -1).numpy()
    )
    np.testing.assert_allclose(found, expected, rtol=2e-4)


def test_a_simulated_photograph_is_shown_again():
    """Pixel by pixel as bright and as lit, through tilt, lens and automatic exposure."""
    camera = PhoneCamera(width=96, height=72, blur=0.01, supersampling=1)
    tilted = FlashSetup(offset=(0.08, 0.05, 0.0), tilt=(0.08, -0.05), vignetting=0.3)

    def card(width, height, texel):
        return replace(flat(width, height, roughness=0.4), texel_size=texel)

    shot = take(card, camera, tilted)
    scene = photographed_scene(shot.setup, Film(96, 72), endless=True)
    found = Renderer(flat(64, 64, roughness=0.4), scene).render().radiance
    off = np.abs(srgb_encode(found) - srgb_encode(shot.linear))
    assert off.max() <= 3.0 / 255.0 and off.mean() <= 0.5 / 255.0


@pytest.mark.parametrize("vignetting", [(-1.5, 0.0), (0.0, -1.5), (-3.0, 1.5), (1.0, -2.0)])
def test_negative_vignetting_spends_no_more_than_the_tolerance(vignetting):
    maps = bumpy(48, 36, relief=1e-3)
    first, second = vignetting
    setup = replace(SETUP_OF_A_PHONE, vignetting=first, vignetting_quartic=second)
    off = srgb_encode(relit(maps, setup)) - srgb_encode(relit(maps, setup, effects="all"))
    assert np.abs(off).max() <= DEFAULT_TOLERANCE


def test_the_command_shows_the_photographed_piece_as_photographed(tmp_path, monkeypatch):
    maps = bumpy(24, 16, relief=0.0)
    monkeypatch.chdir(tmp_path)
    about = {"of": "the photographed piece", SETUP: asdict(SETUP_OF_A_PHONE)}
    write_mapset(maps, tmp_path / "m", MapSetInfo("m" + PIECE, provenance=about))
    options = ("--light", "flash", "--effects", SAME, "-q", "-o")
    assert main(["relight", "m", *options, "flash.exr"]) == 0
    expected = render_rectified(maps, SETUP_OF_A_PHONE).movedim(0, -1).numpy()
    np.testing.assert_allclose(
        read_exr(tmp_path / "flash.exr").pixels, expected, rtol=5e-3, atol=1e-4
    )
    assert main(["relight", "m", *options, "small.png", "--size", "12x8"]) == 0
    assert cv2.imread("small.png").shape == (8, 12, 3)
    # Of maps whose photograph nobody knows, it is the light at the lens, as bright as the others.
    document = json.loads((tmp_path / "m" / f"m{PIECE}.json").read_text())
    document["provenance"] = {}
    (tmp_path / "m" / f"m{PIECE}.json").write_text(json.dumps(document))
    assert main(["relight", "m", *options, "named.exr"]) == 0
    assert np.abs(read_exr(tmp_path / "named.exr").pixels / expected - 1.0).max() > 0.1
