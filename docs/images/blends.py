"""Sheet of ten blends, and how far each step is from both ends.

python docs/images/blends.py [FILE]              simulated photographs; ten minutes of a core
python docs/images/blends.py FILE A B [A B ...]  of materials' files instead

Rows of A, shares 0.25, 0.5 and 0.75, and B: endless fields, lit from the upper left. Simulated
photographs are captured with the preset `instant`; no pair was left out after it was seen.
Distances are style distances by SqueezeNet (lab/matcap_lab/measures/nsd.py) under five lights, over
that of A and B.
"""

from __future__ import annotations

import math
import sys
import tempfile
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from repeats import lit

from matcap.brdf.maps import MapSet
from matcap.capture.run import capture_file
from matcap.capture.settings import CaptureSettings
from matcap.field.material import Material
from matcap.flash.geometry import FlashSetup
from matcap.space.between import blend
from matcap_lab.measures.evaluator import BenchScene, bench_scene, relight_all
from matcap_lab.measures.nsd import SqueezeNetStyle
from matcap_lab.measures.style import StyleStatistics, difference
from matcap_lab.simulate.photograph import PhoneCamera
from matcap_lab.simulate.specimen import photograph, subjects

FILE = Path(__file__).parent / "blends.jpg"
PAIRS = (
    ("leather", "tile"), ("knit:2", "granite"), ("planks:1", "bond:1"), ("cloth", "crackle:4"),
    ("weave", "rust"), ("herringbone", "marble"), ("ribs", "gravel:5"), ("cable", "basket:3"),
    ("hammered", "plaster"), ("terrazzo:5", "scales"),
)  # fmt: skip
_SHARES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
_SHOWN = (0.0, 0.25, 0.5, 0.75, 1.0)
_AREA = (384, 288)  # texels
_STYLE = SqueezeNetStyle()


def main(file: Path = FILE, *materials: Path) -> None:
    """Make the sheet, and print a table."""
    rows = []
    shares = " | ".join(f"{share:g}" for share in _SHARES[1:-1])
    print(f"| A, B | A to B | to A: {shares} | to B: {shares} |\n|---|---:|{'---:|' * 10}")
    for first, second in _files(materials) if materials else _captured():
        steps = [blend(first, second, share).maps(*_AREA, seed=1) for share in _SHARES]
        rows.append(_row([steps[_SHARES.index(share)] for share in _SHOWN]))
        described = [_described(step) for step in steps]
        length = _distance(described[0], described[-1])
        to_both = (
            f"{_distance(step, end) / length:.2f}"
            for end in (described[0], described[-1])
            for step in described[1:-1]
        )
        print(f"| {first.name}, {second.name} | {length:.2f} | {' | '.join(to_both)} |", flush=True)
    Image.fromarray(np.vstack(rows)).save(file, "JPEG", quality=46, optimize=True)
    print(file, file.stat().st_size // 1024, "KB")


def _files(materials: tuple[Path, ...]) -> list[tuple[Material, Material]]:
    read = [Material.load(path) for path in materials]
    return list(zip(read[::2], read[1::2], strict=True))


def _captured() -> list[tuple[Material, Material]]:
    pairs = []
    for names in PAIRS:
        with tempfile.TemporaryDirectory() as folder:
            paths = [
                photograph(subject, PhoneCamera(), Path(folder))[0] for subject in subjects(names)
            ]
            settings = CaptureSettings(preset="instant")
            first, second = (capture_file(path, settings).material for path in paths)
            pairs.append((first, second))
    return pairs


def _row(steps: list[MapSet]) -> NDArray[np.uint8]:
    """Panels in a row, the exposure of both ends interpolated."""
    ends = [0.35 / float((step.diffuse + step.specular).mean()) for step in (steps[0], steps[-1])]
    gains = [ends[0] ** (1.0 - share) * ends[1] ** share for share in _SHOWN]
    return np.hstack([lit(step, gain=gain) for step, gain in zip(steps, gains, strict=True)])


def _described(maps: MapSet) -> StyleStatistics:
    flash = FlashSetup()
    scene = BenchScene(flash.distance, bench_scene(flash).lights[::2])
    bright = math.pi * flash.distance**2  # a white texel in the middle has radiance 1
    with torch.inference_mode():
        return _STYLE(relight_all(maps, (bright,) * 3, scene, size=(256, 256)))


def _distance(first: StyleStatistics, second: StyleStatistics) -> float:
    return float(difference(first, second).mean())


if __name__ == "__main__":
    main(*(Path(name) for name in sys.argv[1:]))
