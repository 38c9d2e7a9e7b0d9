"""Tilt of photographs of regular patterns by the patterns alone, beside matcap's.

    python docs/tools/lattice_tilt.py PHOTOGRAPHS...

The spectra of horizontal frequencies in the upper and the lower fifth of a picture have the same
peaks, one fifth's at frequencies (1 + t dy) times the other's, with dy the distance of both, plane
units, and t the tangent of the tilt about x over the camera's distance: no light takes part. Turned
by 90 degrees, the tilt about y. Angles whose spectra correlate by less than LEAST are left out.
Prints means, and means of absolute differences from that.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.capture.rectified import fit_photograph, tilt_document
from matcap.capture.run import read_photograph
from matcap.capture.settings import DETAIL, CaptureSettings

LEAST = 0.75
SOURCES = ("branch", "used")
_FREQUENCIES = np.exp(np.linspace(math.log(6.0), math.log(120.0), 3000))  # cycles a width
_FARTHEST = 250  # steps of that scale: a ratio of 1.28

Grey = NDArray[np.float32]


def tilt_about_x(texture: Grey, distance: float) -> tuple[float, float]:
    """Degrees, and the correlation of both spectra.

    Args:
        texture: (H, W) log luminance without its local mean.
        distance: of the camera from the plane, in half the longer sides.
    """
    height, fifth = texture.shape[0], texture.shape[0] // 5
    upper, lower = (_spectrum(part) for part in (texture[:fifth], texture[height - fifth :]))
    ratios = range(-_FARTHEST, _FARTHEST + 1, 2)
    alike = [_correlation(upper, lower, shift) for shift in ratios]
    best = int(np.argmax(alike))
    step = math.log(_FREQUENCIES[1] / _FREQUENCIES[0])
    apart = (height - fifth) / (max(texture.shape) / 2.0)
    return math.degrees(math.atan(-ratios[best] * step / apart * distance)), alike[best]


def _spectrum(strip: Grey) -> NDArray[np.float64]:
    """Log power over log frequency, without its slow part."""
    width = strip.shape[1]
    strip = (strip - strip.mean(1, keepdims=True)) * np.hanning(width)
    power = (np.abs(np.fft.rfft(strip, 4 * width)) ** 2).mean(0)
    power = cv2.GaussianBlur(power[None], (0, 0), 1.0)[0]
    log = np.log(np.interp(_FREQUENCIES, np.arange(len(power)) / 4.0, power))
    return np.asarray(log - cv2.GaussianBlur(log[None], (0, 0), 150.0)[0])


def _correlation(upper: NDArray[np.float64], lower: NDArray[np.float64], shift: int) -> float:
    kept = len(upper) - abs(shift)
    pair = upper[max(0, shift) :][:kept], lower[max(0, -shift) :][:kept]
    return float(np.corrcoef(*pair)[0, 1])


def measured(path: Path) -> list[tuple[int, float, dict[str, float]]]:
    """Axis, the pattern's angle and matcap's by source, degrees, of each angle that is clear."""
    photo = read_photograph(path, CaptureSettings(detail=DETAIL))
    log = np.log(photo.pixels.mean(-1) + 0.02 * np.median(photo.pixels))
    texture = log - cv2.GaussianBlur(log, (0, 0), log.shape[1] / 40.0)
    distance = 1.0 / math.tan(math.radians(photo.fov / 2.0))
    about_x, about_y = (tilt_about_x(each, distance) for each in (texture, texture.T))
    clear = [(0, *about_x), (1, *about_y)]
    clear = [each for each in clear if each[2] >= LEAST]
    document = (tilt_document(fit_photograph(photo)) if clear else None) or {}
    return [(axis, angle, {s: document[s][axis] for s in SOURCES}) for axis, angle, _ in clear]


def table(rows: Sequence[tuple[int, float, dict[str, float]]]) -> str:
    """Markdown, a row a source; of an axis without a clear angle, no numbers."""
    lines = ["| tilt | about x: mean | difference | about y: mean | difference |"]
    lines.append("| --- | ---: | ---: | ---: | ---: |")
    axes = [[row for row in rows if row[0] == axis] for axis in (0, 1)]
    means = [f"{np.mean([angle for _, angle, _ in of]):+.1f}" if of else "" for of in axes]
    lines.append(f"| by the pattern | {' | | '.join(means)} | |")
    for source in SOURCES:
        cells = []
        for of in axes:
            said = np.array([by[source] for _, _, by in of])
            off = np.abs(said - [angle for _, angle, _ in of])
            cells.append(f"{said.mean():+.1f} | {off.mean():.1f}" if of else " | ")
        lines.append(f"| {source} | {' | '.join(cells)} |")
    return "\n".join([*lines, "", f"{len(axes[0])} angles about x, {len(axes[1])} about y"])


if __name__ == "__main__":
    print(table([row for path in sys.argv[1:] for row in measured(Path(path))]))
