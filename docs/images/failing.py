"""Simulated photographs that break an assumption of a capture, and what comes out of them.

python docs/images/failing.py FOLDER              the photographs, as JPEGs
python docs/images/failing.py FOLDER sheet.jpg    the same, captured with --preset draft, verdicts
                                                  printed: docs/images/failing.jpg

docs/notes/verdict.md describes each.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from matcap.brdf.maps import MapSet
from matcap.capture.preview import panels
from matcap.capture.run import capture_file
from matcap.capture.settings import CaptureSettings
from matcap.flash.geometry import FlashSetup
from matcap_lab.simulate.files import write_jpeg
from matcap_lab.simulate.kinds import kind_of
from matcap_lab.simulate.photograph import PhoneCamera, Realise, Shot, take, true_maps
from matcap_lab.simulate.specimen import EXAMPLES

CAMERA = PhoneCamera()
LEVEL = FlashSetup(offset=(0.08, 0.05, 0.0), tilt=(math.radians(1.0), 0.0))


def painting() -> Shot:
    """Patches of many colours under one varnish: no part is like another."""
    rng = np.random.default_rng(5)
    patches = rng.uniform(0.05, 0.9, (4, 5, 3))

    def realise(width: int, height: int, texel_size: float) -> MapSet:
        base = EXAMPLES["plaster"].realise(width, height, texel_size)
        size = (width, height)
        colours = cv2.resize(patches, size, interpolation=cv2.INTER_NEAREST)
        return replace(base, diffuse=torch.from_numpy(colours).movedim(-1, 0) * base.diffuse)

    return take(realise, CAMERA, LEVEL)


def knot() -> Shot:
    """A plank with one knot."""
    plank = kind_of("varnish", 3)

    def realise(width: int, height: int, texel_size: float) -> MapSet:
        base = plank.realise(width, height, 1, texel_size)
        y, x = np.mgrid[0:height, 0:width]
        across, down = (x - 0.3 * width) * texel_size, (y - 0.4 * height) * texel_size
        away = torch.from_numpy(np.hypot(across, 1.6 * down))
        rings = 0.75 + 0.25 * torch.cos(away * 120.0)
        inside = torch.exp(-((away / 0.14) ** 4))
        return replace(base, diffuse=base.diffuse * (1.0 - inside * (1.0 - 0.3 * rings)))

    return take(realise, CAMERA, LEVEL)


def tilted() -> Shot:
    """Leather, seen 22 degrees from the side."""
    tilt = (math.radians(20.0), math.radians(-9.0))
    return take(EXAMPLES["leather"].realise, CAMERA, replace(LEVEL, tilt=tilt))


def no_flash() -> Shot:
    """Leather in a room, with no flash."""
    return _lit(EXAMPLES["leather"].realise, lambda albedo, shot: albedo)


def lamp() -> Shot:
    """Leather under a flash and a lamp at the side, which is brighter."""

    def lit(albedo: NDArray[np.float64], shot: NDArray[np.float64]) -> NDArray[np.float64]:
        across = np.linspace(0.0, 1.0, shot.shape[1])[None, :, None]
        return shot + 4.0 * shot.mean() * albedo / albedo.mean() * across**2

    return _lit(EXAMPLES["leather"].realise, lit)


def polished() -> Shot:
    """A black polished stone, whose highlight is a spike of a few pixels."""

    def realise(width: int, height: int, texel_size: float) -> MapSet:
        base = kind_of("terrazzo", 2).realise(width, height, 1, texel_size)
        one = torch.ones_like(base.roughness)
        return replace(
            base, diffuse=0.1 * base.diffuse, specular=0.04 * one, roughness=0.07 * one,
            height=0.0 * base.height,
        )  # fmt: skip

    return take(realise, CAMERA, LEVEL)


def brushed() -> Shot:
    """Brushed metal, whose highlight is a streak across its brushing."""
    metal = kind_of("brushed", 1)
    return take(lambda w, h, texel: metal.realise(w, h, 1, texel), CAMERA, LEVEL)


def check() -> Shot:
    """A woven check of half the picture's width."""

    def realise(width: int, height: int, texel_size: float) -> MapSet:
        base = EXAMPLES["cloth"].realise(width, height, texel_size)
        x, y = np.arange(width) * texel_size, np.arange(height) * texel_size
        bars = [np.where((along % 1.0) < 0.5, 1.0, 0.25) for along in (x, y)]
        bright = torch.from_numpy(0.5 * (bars[0][None, :] + bars[1][:, None]))
        return replace(base, diffuse=base.diffuse * bright)

    return take(realise, CAMERA, LEVEL)


# In the order of the sheet's rows.
SHOTS: dict[str, Callable[[], Shot]] = {
    "brushed": brushed,
    "check": check,
    "knot": knot,
    "lamp": lamp,
    "no-flash": no_flash,
    "painting": painting,
    "polished": polished,
    "tilted": tilted,
}
COLUMNS = ("photograph", "re-rendered", "light from the top", "diffuse")
PANEL = (264, 198)  # pixels, width and height


def row(photograph: Path) -> NDArray[np.uint8]:
    """(height, 4 x width, 3) sRGB codes of COLUMNS for the capture of a photograph."""
    result = capture_file(photograph, CaptureSettings(preset="draft"))
    print(photograph.stem, result.verdict.sentence(), flush=True)
    shown = {panel.label: panel.pixels for panel in panels(result)}
    small = [cv2.resize(shown[label], PANEL, interpolation=cv2.INTER_AREA) for label in COLUMNS]
    return np.rint(255.0 * np.concatenate(small, axis=1).clip(0.0, 1.0)).astype(np.uint8)


def _lit(
    realise: Realise, lit: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]
) -> Shot:
    """A shot under another light, which is made of albedo and of the shot under the flash."""
    shot = take(realise, CAMERA, LEVEL)
    albedo = true_maps(realise, CAMERA, LEVEL).diffuse.movedim(0, -1).numpy()
    linear = lit(albedo, shot.linear)
    return replace(shot, linear=0.22 * linear / linear.mean())


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{name}.jpg" for name in SHOTS]
    for file in files:
        write_jpeg(file, SHOTS[file.stem](), 1)
        print(file, flush=True)
    if len(sys.argv) > 2:
        sheet = np.concatenate([row(file) for file in files], axis=0)
        Image.fromarray(sheet).save(sys.argv[2], "JPEG", quality=82)
