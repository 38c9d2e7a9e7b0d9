"""Measurements of causes of a poor capture, in photograph and re-rendering.

A cause is reported if its measurement exceeds its limit in the table (photo/checks.py).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.capture.verdict.exemplar_measurements import ExemplarMeasurements
from matcap.flash.highlight import Highlight, elongation, light_of
from matcap.photo.checks import CAUSES, UNIFORM, Cause
from matcap.photo.photo import Photo

Picture = NDArray[np.float32]
SmoothLight = NDArray[np.float64]

# Settings of the measurements; docs/notes/verdict.md.
_RING_TERMS = 6  # piecewise linear terms in the distance from the centre
# Quantile of the light above which texels are not fitted, as the highlight's error would look
# like a tone curve.
_BRIGHTEST = 0.7
_STRIP = 0.06  # width of the border that represents a side, as a share of the picture's
# Inner and outer radius, plane units, of the ring that represents the centre.
_CENTRE_RING = (0.25, 0.5)
_CLIP = 0.995  # pixel value from which a channel counts as clipped


@dataclass(frozen=True)
class CauseMeasurements:
    """Measurements of causes in the photograph; the defaults mean that there is none."""

    side: float = -1.0
    """Log ratio of the brightest side's light to that around the centre; negative under a flash in
    any direction."""
    room: float = 0.0
    """Uniform radiance added to the flash's, as a share of the radiance of dark parts."""
    curve: float = 0.0
    """Root-mean-square difference of log radiance that is a function of brightness."""
    streak: float = 1.0
    """Length over width of the highlight, divided by that of the re-rendered one."""
    channels: float = 0.0
    """Share of the photograph where some channels are clipped and others are not."""
    developed: bool = False
    """Whether the photograph is developed, so that it can have a tone curve."""
    fired: bool | None = None
    """Whether the flash fired by the file's metadata; None if unknown."""

    @staticmethod
    def of(
        photo: Photo,
        smooth: tuple[SmoothLight, SmoothLight],
        pictures: tuple[Picture, Picture],
        highlights: tuple[Highlight | None, Highlight | None],
    ) -> CauseMeasurements:
        """Measure a photograph and its re-rendering.

        Args:
            photo: the photograph.
            smooth: (h, w, 3) low-pass filtered photograph and re-rendering on the plane.
            pictures: (H, W, 3) both, unfiltered.
            highlights: of both.
        """
        light, model = (each.mean(axis=2) for each in smooth)
        clipped = photo.pixels >= _CLIP
        return CauseMeasurements(
            side=_brightest_side(light),
            room=_ambient_share(light, model),
            curve=_tone_difference(light, model),
            streak=_streak(pictures, highlights),
            channels=float((clipped[..., 1:] != clipped[..., :1]).any(axis=2).mean()),
            developed=not photo.radiometric,
            fired=photo.flash_fired,
        )


def more_photographs(given: int) -> str:
    """Remedy for a capture that one or more photographs do not determine well enough."""
    if given < 2:
        return "take five photographs and give them with --together, which measure more than one"
    if given < 5:
        return f"add photographs from other sides to these {given}: five measure more"
    return "photograph again with the phone moved further to each side (see matcap inspect)"


def causes(
    seen: CauseMeasurements, exemplar: ExemplarMeasurements, photographs: int
) -> tuple[Cause, ...]:
    """Causes beyond their limits, the strongest first; of a sample with so many photographs."""
    uniform = 0.0 <= seen.side <= UNIFORM
    curve, room = CAUSES["tone curve"], CAUSES["room light"]
    bent = seen.developed and curve.strength(seen.curve) >= room.strength(seen.room)
    values = {
        "anisotropic highlight": seen.streak,
        "no flash": float(uniform and not seen.fired),
        "light from a side": -math.inf if uniform else seen.side,
        "room light": 0.0 if bent else seen.room,
        "tone curve": seen.curve if bent else 0.0,
        "clipping by channel": seen.channels,
        "steep relief": exemplar.tilt,
        "large features": exemplar.variety,
    }
    strengths = {name: CAUSES[name].strength(value) for name, value in values.items()}
    names = sorted(strengths, key=lambda name: -strengths[name])
    words = {
        "times": math.exp(seen.side),
        "share": min(seen.room, 1.0),
        "more": more_photographs(photographs),
    }
    return tuple(
        CAUSES[name].described(values[name], **words) for name in names if strengths[name] >= 1.0
    )


def by_place(difference: SmoothLight) -> SmoothLight:
    """(h, w) projection of a difference on functions that are linear in position or depend on the
    distance from the centre: light varies so, texture hardly does.
    """
    terms = np.concatenate([_plane(difference.shape), _rings(difference.shape)])
    return _projected(difference, terms)


def _brightest_side(light: SmoothLight) -> float:
    """Log ratio of the brightest side to the surroundings of the centre, of smooth light (h, w)."""
    height, width = light.shape
    rows, columns = (max(1, round(_STRIP * side)) for side in (height, width))
    sides = (light[:rows], light[-rows:], light[:, :columns], light[:, -columns:])
    distance = np.hypot(*_from_middle(light.shape)) * 2.0
    around = light[(distance > _CENTRE_RING[0]) & (distance < _CENTRE_RING[1])]
    brightest = max(float(np.median(side)) for side in sides)
    return float(np.log((brightest + 1e-6) / (np.median(around) + 1e-6)))


def _tone_difference(light: SmoothLight, model: SmoothLight) -> float:
    """Standard deviation of log(light / model) explained by log model and its square.

    Fitted together with functions linear in position.
    """
    floor = 0.02 * float(np.median(light)) + 1e-6
    difference = np.log((light + floor) / (model + floor))
    level = np.log(model + floor)
    level = (level - level.mean()) / max(float(level.std()), 1e-6)
    bent = np.stack([level, np.square(level)])
    plane = _plane(difference.shape)
    terms = np.concatenate([bent, plane, np.ones((1, *difference.shape))])
    weights = np.linalg.lstsq(terms.reshape(len(terms), -1).T, difference.ravel(), rcond=1e-9)[0]
    curve = np.einsum("n,nhw->hw", weights[: len(bent)], bent)
    return float(curve.std())


def _ambient_share(light: SmoothLight, model: SmoothLight) -> float:
    """Offset b of the fit light = a model + b, over the 10 % quantile of light."""
    fit = model < np.quantile(model, _BRIGHTEST)
    weight = 1.0 / (model[fit] + 1e-6)  # relative residuals
    columns = np.stack([model[fit] * weight, weight], axis=1)
    added = float(np.linalg.lstsq(columns, light[fit] * weight, rcond=None)[0][1])
    return max(added, 0.0) / (float(np.quantile(light, 0.1)) + 1e-6)


def _streak(
    pictures: tuple[Picture, Picture], highlights: tuple[Highlight | None, Highlight | None]
) -> float:
    """Length over width of the highlight over that re-rendered; 1 without one in the photograph."""
    photographed, rendered = (
        1.0 if highlight is None else elongation(light_of(picture), highlight)
        for picture, highlight in zip(pictures, highlights, strict=True)
    )
    return max(photographed / rendered, 1.0)


def _plane(shape: Sequence[int]) -> SmoothLight:
    """(2, h, w) from -1/2 at one side to 1/2 at the other."""
    down, across = (np.linspace(-0.5, 0.5, side) for side in shape)
    return np.stack(np.broadcast_arrays(across[None, :], down[:, None]))


def _rings(shape: Sequence[int]) -> SmoothLight:
    """(rings, h, w) linear interpolation weights in the distance from the centre; they sum to 1."""
    distance = np.hypot(*_from_middle(shape))
    at = distance / distance.max() * (_RING_TERMS - 1)
    return np.stack([np.clip(1.0 - np.abs(at - ring), 0.0, 1.0) for ring in range(_RING_TERMS)])


def _from_middle(shape: Sequence[int]) -> tuple[SmoothLight, SmoothLight]:
    """Offsets of columns (1, w) and rows (h, 1) from the centre; the long side is 1."""
    down, across = ((np.arange(side) + 0.5 - side / 2.0) / max(shape) for side in shape)
    return across[None, :], down[:, None]


def _projected(plane: SmoothLight, terms: SmoothLight) -> SmoothLight:
    """Least-squares projection of a plane (h, w) on terms (n, h, w)."""
    flat = terms.reshape(len(terms), -1)
    weights = np.linalg.lstsq(flat.T, plane.ravel(), rcond=1e-9)[0]
    return np.asarray(np.einsum("n,nhw->hw", weights, terms), np.float64)
