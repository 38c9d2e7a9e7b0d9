"""Real materials in one file: packed, cut into pieces, photographed, held out."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from matcap.brdf.maps import SURFACE
from matcap.brdf.normals import normals_from_height
from matcap.errors import MatcapError
from matcap_lab.inverse.samples import (
    LEVELS,
    PackedSet,
    coloured_metal,
    cut,
    draw_sample,
    halved,
    held_out_sets,
    is_held_out,
    open_pack,
    pack,
    real_piece,
    training_sets,
)

SIDE = 64
NAMES = tuple(f"material{i}" for i in range(12))


def relief(phase: float = 0.0) -> np.ndarray:
    """(1, SIDE, SIDE) periodic height in texels."""
    y, x = np.mgrid[:SIDE, :SIDE] * 2.0 * math.pi / SIDE
    waves = 3.0 * np.sin(2.0 * x + phase) + 1.5 * np.cos(3.0 * y - x) + np.sin(5.0 * y)
    return waves[None].astype(np.float32)


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sets")
    rng = np.random.default_rng(0)
    for index, name in enumerate(NAMES):
        (folder / name).mkdir()
        normal = normals_from_height(torch.from_numpy(relief(index)), 1.0, periodic=True)
        coded = np.rint((normal.numpy() * 0.5 + 0.5) * 255.0).astype(np.uint8)
        cv2.imwrite(str(folder / name / "normal.png"), coded.transpose(1, 2, 0)[..., ::-1])
        colour = rng.integers(40, 200, (SIDE, SIDE, 3), dtype=np.uint8)
        cv2.imwrite(str(folder / name / "basecolor.png"), colour)
        cv2.imwrite(str(folder / name / "roughness.png"), colour[..., 0])
        if index == 0:
            metal = np.full((SIDE, SIDE), 255, np.uint8)
            cv2.imwrite(str(folder / name / "metallic.png"), metal)
    assert pack(folder, folder / "maps.pack") == len(NAMES)
    return folder / "maps.pack"


def picture(path: Path) -> np.ndarray:
    """(H, W, 3) in [0, 1]."""
    read = cv2.imread(str(path))
    assert read is not None
    return np.asarray(read[..., ::-1], np.float32) / 255.0


def sets(packed: Path) -> tuple[PackedSet, ...]:
    return tuple(open_pack(packed).values())


def test_packed_maps_are_the_sets(packed: Path) -> None:
    assert tuple(open_pack(packed)) == tuple(sorted(NAMES))
    plain = open_pack(packed)["material1"]
    assert [s.shape for s in plain.surface] == [(8, SIDE >> i, SIDE >> i) for i in range(LEVELS)]
    assert plain.surface[0].dtype == torch.float16
    folder = packed.parent / "material1"
    roughness = picture(folder / "roughness.png")[..., 0]
    assert np.allclose(plain.surface[0][6].float().numpy(), roughness, atol=1e-3)
    colour = picture(folder / "basecolor.png")
    linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    assert np.allclose(plain.surface[0][:3].float().numpy().transpose(1, 2, 0), linear, atol=1e-3)
    assert np.allclose(plain.surface[0][3:6].float(), 0.04, atol=1e-4)
    metal = open_pack(packed)["material0"].surface[0].float()
    assert float(metal[:3].max()) == 0.0 and float(metal[7].min()) == 1.0
    off = normals_from_height(plain.height[0], 1.0, periodic=True) - normals_from_height(
        torch.from_numpy(relief(1)), 1.0, periodic=True
    )
    assert float(off.abs().mean()) < 0.01


def test_slopes_lost_by_halving_count_as_roughness() -> None:
    surface = np.full((8, SIDE, SIDE), 0.3, np.float32)
    rough = np.zeros((1, SIDE, SIDE), np.float32)
    rough[0] = np.sin(np.arange(SIDE) * math.pi / 2.0)  # waves of four texels
    even, _ = halved(surface, 0.0 * rough)
    lost, height = halved(surface, rough)
    assert np.allclose(even, 0.3, atol=1e-5)
    assert float(lost[6].mean()) > 0.5
    assert height.shape == (1, SIDE // 2, SIDE // 2)


def test_the_split_is_by_name_and_disjoint(packed: Path) -> None:
    trained = {s.name for s in training_sets(packed)}
    left = {s.name for s in held_out_sets(packed)}
    assert trained | left == set(NAMES)
    assert not trained & left
    assert left == {name for name in NAMES if is_held_out(name)}
    shares = sum(is_held_out(f"some material {i}") for i in range(2000)) / 2000
    assert shares == pytest.approx(0.2, abs=0.03)


def test_pieces_keep_slopes_at_every_scale(packed: Path) -> None:
    whole = sets(packed)[1]
    steepness = float(np.square(np.gradient(relief(1)[0])).sum(0).mean())
    for scale in (0.8, 1.0, 2.0):
        piece = cut(whole, 0, scale, np.random.default_rng(4), 96, 80)
        assert piece.shape == (9, 80, 96)
        assert np.square(np.gradient(piece[-1])).sum(0).mean() == pytest.approx(steepness, rel=0.25)


def test_pieces_of_real_materials_are_maps(packed: Path) -> None:
    for seed in range(20):
        maps, metal = real_piece(sets(packed), np.random.default_rng(seed), 72, 56)
        assert maps.size == (72, 56) and metal.shape == (1, 56, 72)
        stacked = maps.stacked()
        assert bool(torch.isfinite(stacked).all())
        assert float(stacked[SURFACE].min()) > 0.0 and float(stacked[SURFACE].max()) <= 1.0
        assert float(metal.min()) >= 0.0 and float(metal.max()) <= 1.0


def test_metal_is_drawn_in_colours_and_what_is_none_stays_grey() -> None:
    f0 = np.full((3, 8, 8), 0.5, np.float32)
    metal = np.ones((1, 8, 8), np.float32)
    metal[:, :4], f0[:, :4] = 0.0, 0.04
    hues = []
    for seed in range(40):
        drawn = coloured_metal(f0, metal, np.random.default_rng(seed))
        assert np.array_equal(drawn[:, :4], f0[:, :4])
        bare = drawn[:, 6, 6]
        assert bare.min() > 0.0 and bare.max() < 1.0
        hues.append(float(bare.max() / bare.min()))
    assert min(hues) == 1.0 and max(hues) > 3.0
    plain = coloured_metal(0.08 * f0, 0.0 * metal, np.random.default_rng(0))
    assert np.array_equal(plain, 0.08 * f0)


def test_a_real_sample_is_a_function_of_its_number(packed: Path) -> None:
    first, again, other = (
        draw_sample(number, 64, 64, sets=sets(packed), real=1.0) for number in (5, 5, 6)
    )
    assert torch.equal(first.linear, again.linear)
    assert torch.equal(first.truth.stacked(), again.truth.stacked())
    assert first.uniform == again.uniform
    assert not torch.equal(first.linear, other.linear)


def test_other_files_are_no_packed_maps(tmp_path: Path) -> None:
    (tmp_path / "maps.pack").write_bytes(b"nothing of the kind")
    with pytest.raises(MatcapError, match="pack of maps cannot be read"):
        open_pack(tmp_path / "maps.pack")
    with pytest.raises(MatcapError, match="no map sets"):
        pack(tmp_path, tmp_path / "out.pack")
