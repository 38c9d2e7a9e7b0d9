"""How strong relief and albedo are, told of a photograph alone, and by `matcap inspect`."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from arrays import photo_from_array
from photographed import photographed
from typer.testing import CliRunner

from matcap.capture.exemplar.observation import Observation
from matcap.capture.exemplar.relief_spectrum import slope_spectrum
from matcap.cli.main import app
from matcap.files.srgb import srgb_encode
from matcap.flash.coarse.fit import fit_coarse
from matcap.flash.plane import read_plane


def _shot(width: int, height: int) -> tuple[np.ndarray, float]:
    """A linear picture (H, W, 3) in [0, 1], and its true relief."""
    shot = photographed(0.2, 0.05, width=width, height=height)
    linear = (shot.linear / shot.linear.quantile(0.999)).permute(1, 2, 0).clamp(0.0, 1.0)
    heights = (shot.maps.height / shot.maps.texel_size)[0].numpy()
    true = float(np.sqrt(np.square(slope_spectrum(heights)).sum()))
    return np.ascontiguousarray(linear.numpy()), true


def _inspected(path: Path, linear: np.ndarray, *options: str) -> str:
    cv2.imwrite(str(path), (srgb_encode(linear)[..., ::-1] * 65535).astype(np.uint16))
    said = CliRunner().invoke(app, ["inspect", str(path), *options])
    assert said.exit_code == 0, said.output
    return said.stdout


def test_relief_is_told_without_knowing_anything_but_the_photograph() -> None:
    linear, true = _shot(768, 576)
    photo = photo_from_array(linear, long_side=768, fov=65.0, radiometric=True, name="bumps")
    coarse = fit_coarse(photo)
    result = Observation.of(read_plane(photo, coarse.setup, 768), coarse).relief_spectrum()
    assert result is not None
    assert result.relief == pytest.approx(true, rel=0.1)


def test_inspect_tells_it_of_a_file(tmp_path: Path) -> None:
    linear, true = _shot(768, 576)
    said = _inspected(tmp_path / "bumps.png", linear, "--json")
    (document,) = json.loads(said)["photographs"]
    # Less than it is: of a PNG neither tone curve nor field of view is known.
    assert 0.5 < document["relief_spectrum"]["relief"] / true < 1.2


def test_of_a_small_picture_it_is_not_told(tmp_path: Path) -> None:
    said = _inspected(tmp_path / "bumps.png", _shot(160, 120)[0])
    assert "hot_spot" in said and "relief" not in said
