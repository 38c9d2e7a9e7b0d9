"""`matcap inspect` tells how strong relief and albedo are, of a photograph's file."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from photographed import photographed
from typer.testing import CliRunner

from matcap.capture.exemplar.strengths import slope_strengths
from matcap.cli.main import app
from matcap.files.srgb import srgb_encode


def _told(folder: Path, width: int, height: int, *options: str) -> tuple[str, float]:
    """What is said of a simulated photograph, and its true relief."""
    shot = photographed(0.2, 0.05, width=width, height=height)
    linear = (shot.linear / shot.linear.quantile(0.999)).permute(1, 2, 0).numpy()
    path = folder / "bumps.png"
    coded = srgb_encode(linear.clip(0.0, 1.0))[..., ::-1]
    cv2.imwrite(str(path), (coded * 65535).astype(np.uint16))
    said = CliRunner().invoke(app, ["inspect", str(path), *options])
    assert said.exit_code == 0, said.output
    heights = (shot.maps.height / shot.maps.texel_size)[0].numpy()
    return said.stdout, float(np.sqrt(np.square(slope_strengths(heights)).sum()))


def test_reliefs_strength_is_told_of_a_file_alone(tmp_path: Path) -> None:
    said, true = _told(tmp_path, 768, 576, "--json")
    (document,) = json.loads(said)["photographs"]
    assert document["strengths"]["relief"] == pytest.approx(true, rel=0.35)


def test_of_a_small_picture_it_is_not_told(tmp_path: Path) -> None:
    said, _ = _told(tmp_path, 160, 120)
    assert "hot_spot" in said and "relief" not in said
