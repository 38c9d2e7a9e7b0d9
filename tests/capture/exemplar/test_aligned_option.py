"""`capture --aligned` and `--generator example`, as a user gives them."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from materials import a_material
from photographed import photographed
from PIL import Image
from typer.testing import CliRunner

from matcap.brdf.folder import find_mapsets, read_mapset
from matcap.cli.main import app
from matcap.errors import UsageError
from matcap.field.material import Material
from matcap.files.exr import read_exr
from matcap.files.srgb import srgb_encode
from matcap.space.between import blend


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("aligned")
    shot = photographed(0.15, 0.2, width=320, height=240)
    linear = (shot.linear / shot.linear.quantile(0.995)).permute(1, 2, 0).numpy()
    photo = out / "bumps.png"
    cv2.imwrite(
        str(photo), (srgb_encode(linear.clip(0.0, 1.0))[..., ::-1] * 65535).astype(np.uint16)
    )
    result = CliRunner().invoke(
        app,
        ["capture", str(photo), "-o", str(out), "--preset", "instant", "--size", "64x64",
         "--detail", "320",
         "--aligned", "--generator", "example", "-q"],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    return out / photo.stem


def test_the_piece_is_written_beside_the_material(folder: Path) -> None:
    name = folder.name
    maps, document = read_mapset(folder / f"{name}_photo.json")
    trusted = read_exr(folder / f"{name}_photo_confidence.exr").pixels
    assert trusted.shape == (maps.size[1], maps.size[0], 4)
    assert 0.0 <= trusted.min() <= trusted.max() <= 1.0
    assert document["provenance"]["of"] == "the photographed piece"
    # A folder still means its material's own set.
    assert find_mapsets(folder) == [folder / f"{name}.json"]


def test_the_material_holds_the_piece_and_is_read_by_it(folder: Path) -> None:
    material = Material.load(folder / f"{folder.name}.matcap")
    assert set(material.generators) == {"example"}
    assert material.maps(48, 48, seed=2).size == (48, 48)
    with pytest.raises(UsageError, match="no decoder of its own"):
        material.maps(48, 48, generator="decoder")


def test_it_is_blended_with_a_decoders_field(folder: Path) -> None:
    material = Material.load(folder / f"{folder.name}.matcap")
    drawn = a_material("drawn", across=512)
    between = blend(material, drawn, 0.5)
    assert set(between.generators) == {"example"}
    assert between.texel_size == pytest.approx((material.texel_size * drawn.texel_size) ** 0.5)
    assert bool(between.maps(48, 48).diffuse.isfinite().all())
    assert blend(material, drawn, 0.0) is material


def test_the_preview_shows_the_piece_beside_the_photograph(folder: Path) -> None:
    with Image.open(folder / "preview.png") as sheet:
        whole = np.asarray(sheet).astype(int)
    for lines in range(1, 8):  # of the verdict, above two blocks of one size
        blocks = whole[20 + 28 * lines :].reshape(2, -1, whole.shape[1], 3)
        (first, second), (own_first, own_second) = (
            [block[100:400, x : x + 500] for x in (20, 20 + (blocks.shape[2] - 12) // 4)]
            for block in blocks
        )
        if np.array_equal(first, own_first):
            break
    assert np.array_equal(first, own_first) and first.std() > 1.0
    # The piece re-renders to the photograph texel by texel; more of the material cannot.
    away, own_away = (np.abs(again - first).mean() for again in (second, own_second))
    assert own_away < 0.5 * away


def test_the_report_says_how_right_it_is(folder: Path) -> None:
    values = json.loads((folder / "report.json").read_text())["exemplar"]
    assert 0.0 <= values["error"] < 0.5
    assert 0.0 <= values["left_out"] < 0.5
    assert 0.0 < values["relief_spectrum"]["relief"] < 1.0
    assert set(values["confidence"]) == {"diffuse", "specular", "roughness", "height"}
