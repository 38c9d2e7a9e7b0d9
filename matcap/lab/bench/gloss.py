"""What is told of a plain material's gloss: roughness and F0 found for true, over exposures.

Even albedo, F0 and roughness, flat or with bumps that break the highlight up, photographed at the
camera's own exposure and stops above it, so that more and more of the highlight is clipped.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch

from matcap.brdf.maps import MapSet
from matcap.capture.pipeline import capture_photo
from matcap.capture.settings import CaptureSettings
from matcap.flash.coarse import fit_coarse
from matcap.flash.geometry import FlashSetup
from matcap.lab.simulate.photograph import PhoneCamera, Shot, as_photo, take

SETUP = FlashSetup(offset=(0.10, 0.05, 0.0), tilt=(0.02, -0.02))
WITHIN = 0.05  # of roughness
_BUMPS = 0.03  # plane units apart


@dataclass(frozen=True)
class PlainMaterial:
    """An even material.

    Attributes:
        albedo: (3,) linear.
        specular: F0.
        roughness: perceptual.
        slope: root-mean-square of its bumps.
    """

    albedo: tuple[float, float, float]
    specular: float
    roughness: float
    slope: float

    def realise(self, width: int, height: int, texel_size: float) -> MapSet:
        """A piece of it; the same bumps at any detail."""
        one = torch.ones(1, height, width)
        count = round(2.0 / _BUMPS)
        heights = np.random.default_rng(3).standard_normal((count, count)).astype(np.float32)
        side = max(width, height)
        bumps = cv2.resize(heights, (side, side), interpolation=cv2.INTER_CUBIC)[:height, :width]
        down, across = np.gradient(bumps / texel_size)
        steep = float(np.sqrt(np.mean(down**2 + across**2)))
        bumps = np.asarray(bumps * (self.slope / steep), np.float32)
        colour = torch.tensor(self.albedo)[:, None, None].expand(3, height, width)
        return MapSet(
            colour.clone(),
            one * self.specular,
            one * self.roughness,
            torch.from_numpy(bumps)[None],
            texel_size,
        )


@dataclass(frozen=True)
class GlossRow:
    """What one photograph told.

    Attributes:
        material: what was photographed.
        stops: above the camera's own exposure.
        clipped: share of the photograph.
        roughness, specular: as found by the coarse fit, or of the piece, mean.
    """

    material: PlainMaterial
    stops: int
    clipped: float
    roughness: float
    specular: float


def materials(slopes: Sequence[float]) -> Iterator[PlainMaterial]:
    """Roughness times F0 times albedo, at each slope."""
    for slope, albedo, specular, roughness in itertools.product(
        slopes,
        ((0.3, 0.2, 0.15), (0.02, 0.02, 0.02)),
        (0.04, 0.1),
        (0.05, 0.1, 0.15, 0.2, 0.4, 0.7, 0.95),
    ):
        yield PlainMaterial(albedo, specular, roughness, slope)


def run_gloss(
    chosen: Iterator[PlainMaterial],
    stops: Sequence[int],
    *,
    piece: bool = False,
    tell: Callable[[str], None] = lambda _line: None,
) -> list[GlossRow]:
    """Photograph materials at exposures, and see what is told.

    Args:
        chosen: the materials.
        stops: exposures.
        piece: capture the piece, whose maps are told; the coarse fit alone otherwise.
        tell: called with a line a material.
    """
    rows = []
    for material in chosen:
        shot = take(material.realise, PhoneCamera(), SETUP)
        found = [_told(material, shot, each, piece=piece) for each in stops]
        rows += found
        tell(f"{material} " + " ".join(f"{row.roughness:.2f}/{row.specular:.3f}" for row in found))
    return rows


def _told(material: PlainMaterial, shot: Shot, stops: int, *, piece: bool) -> GlossRow:
    gain = 2.0**stops
    setup = shot.setup.with_intensity((gain * shot.setup.intensity[0],) * 3)
    brighter = replace(shot, linear=gain * shot.linear, setup=setup)
    photo = as_photo(brighter, 1, "plain")
    clipped = float((brighter.linear.max(-1) >= 1.0).mean())
    if piece:
        result = capture_photo(photo, CaptureSettings(preset="instant", detail=512))
        assert result.found is not None
        maps = result.found.exemplar
        gloss = float(maps.roughness.mean()), float(maps.specular.mean())
    else:
        fit = fit_coarse(photo)
        gloss = fit.roughness, fit.specular
    return GlossRow(material, stops, clipped, *gloss)


def gloss_markdown(rows: Sequence[GlossRow], command: str) -> str:
    """A table, a line a material, and how many are told within WITHIN where roughness is 0.2 or
    less, at each exposure.
    """
    stops = sorted({row.stops for row in rows})
    lines = [
        f"    {command}",
        "",
        "| slope | albedo | F0 | roughness | " + " | ".join(f"{s:+d} stops" for s in stops) + " |",
        "| --- " * (4 + len(stops)) + "|",
    ]
    for material in dict.fromkeys(row.material for row in rows):
        found = [
            f"{row.roughness:.2f}, {row.specular:.3f} ({100.0 * row.clipped:.0f} %)"
            for row in rows
            if row.material == material
        ]
        lines.append(
            f"| {material.slope:g} | {material.albedo[0]:g} | {material.specular:g} "
            f"| {material.roughness:g} | " + " | ".join(found) + " |"
        )
    lines += ["", "Roughness and F0 as found, share clipped."]
    for slope in sorted({row.material.slope for row in rows}):
        polished = [r for r in rows if r.material.slope == slope and r.material.roughness <= 0.2]
        near = [
            f"{sum(map(_near, at))} of {len(at)} at {s:+d}"
            for s in stops
            if (at := [row for row in polished if row.stops == s])
        ]
        lines.append(f"Slope {slope:g}, roughness 0.2 or less, within {WITHIN}: {', '.join(near)}.")
    return "\n".join(lines)


def _near(row: GlossRow) -> bool:
    return abs(row.roughness - row.material.roughness) <= WITHIN
