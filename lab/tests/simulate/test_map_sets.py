"""Artists' map sets as materials, of tiny sets made here."""

import json

import cv2
import numpy as np
import pytest
import torch

from matcap.errors import MatcapError
from matcap.flash.geometry import FlashSetup
from matcap_lab.simulate.photograph import PhoneCamera, take
from matcap_lab.simulate.specimen import Specimen, map_set_folders, read_map_set

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
