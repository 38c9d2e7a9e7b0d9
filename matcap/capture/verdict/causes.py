"""Causes of a poor capture that can be measured in the photograph, each with a remedy.

Each cause has its own measurement, from photograph and re-rendering, and is reported if that
exceeds its limit (docs/notes/verdict.md).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from matcap.flash.highlight import Highlight, elongation, light_of

Picture = NDArray[np.float32]
SmoothLight = NDArray[np.float64]

DARK = (
    "photograph in a dark room, with other lights off, or take one more without flash and give "
    "them with --together"
)
_HIGHLIGHT = frozenset({"highlight_contrast", "highlight_place", "highlight_width"})
_LIGHT = _HIGHLIGHT | {"light", "colour", "piece", "flash", "tilt", "flash_offset"}
# A highlight of the wrong contrast looks like a tone curve or ambient light.
_LEVELS = _LIGHT - {"highlight_contrast"}
_DRAWING = frozenset({"texture", "contrast", "connectivity", "order", "light"})
_RELIEF = frozenset({"texture", "contrast", "piece", "confidence", "glint_contrast"})
_CLIPPED = _HIGHLIGHT | {"clipped", "colour", "confidence", "piece", "contrast", "light"}


# Limits of CauseMeasurements at which a cause is reported; docs/notes/verdict.md.

# Log ratio of `side` that adds 1 to the strength; any positive ratio excludes a flash.
_SIDE_UNIT = 0.3
_EVEN = 0.1  # largest log ratio of `side` that counts as uniform light
_MOST_ROOM = 0.25  # limit of the share of ambient light, CauseMeasurements.room
_MOST_CURVE = 0.12  # limit of the tone curve's difference of log radiance, CauseMeasurements.curve
_MOST_STREAK = 1.35  # limit of the highlight's elongation, CauseMeasurements.streak
# Limit of the share clipped in some channels only, CauseMeasurements.channels.
_MOST_CHANNELS = 0.04
_MOST_TILT = 25.0  # limit of the mean angle of normals, degrees, CauseMeasurements.tilt
_LEAST_VARIETY = 0.2  # limit of `variety`, below which features are as large as the photograph
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
    """Measurements of causes; the defaults mean that there is none."""

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
    tilt: float = 0.0
    """Mean angle of the exemplar's normals to the plane's, degrees."""
    variety: float = 1.0
    """Patch size of the field: 1 for small patches, 0 for the whole exemplar, whose features are as
    large as the photograph."""
    developed: bool = False
    """Whether the photograph is developed, so that it can have a tone curve."""
    fired: bool | None = None
    """Whether the flash fired by the file's metadata; None if unknown."""
    photographs: int = 1
    """Number of photographs of the sample."""

    def with_photograph(
        self,
        pixels: Picture,
        smooth: tuple[SmoothLight, SmoothLight],
        pictures: tuple[Picture, Picture],
        highlights: tuple[Highlight | None, Highlight | None],
    ) -> CauseMeasurements:
        """Add measurements from the photograph and its re-rendering.

        Args:
            pixels: (H, W, 3) the photograph, linear, 1 at clipping.
            smooth: (h, w, 3) low-pass filtered photograph and re-rendering on the plane.
            pictures: (H, W, 3) both, unfiltered.
            highlights: of both.
        """
        light, model = (each.mean(axis=2) for each in smooth)
        clipped = pixels >= _CLIP
        return replace(
            self,
            side=_brightest_side(light),
            room=_laid_over(light, model),
            curve=_bent(light, model),
            streak=_streak(pictures, highlights),
            channels=float((clipped[..., 1:] != clipped[..., :1]).any(axis=2).mean()),
        )


@dataclass(frozen=True)
class Cause:
    """A cause of differences between photograph and re-rendering."""

    name: str
    """Name in the report."""
    strength: float
    """The measurement over its limit; a cause is reported from 1."""
    says: str
    """Description for the verdict."""
    remedy: str
    """Remedy for the verdict."""
    explains: frozenset[str]
    """Keys of the checks that it can affect."""


def more_photographs(given: int) -> str:
    """Remedy for a capture that one or more photographs do not determine well enough."""
    if given < 2:
        return "take five photographs and give them with --together, which measure more than one"
    if given < 5:
        return f"add photographs from other sides to these {given}: five measure more"
    return "photograph again with the phone moved further to each side (see matcap inspect)"


def causes(measured: CauseMeasurements) -> tuple[Cause, ...]:
    """Causes with a strength of at least 1, the strongest first."""
    visible = [cause for cause in _all(measured) if cause.strength >= 1.0]
    return tuple(sorted(visible, key=lambda cause: -cause.strength))


def _all(measured: CauseMeasurements) -> Iterator[Cause]:
    """Every cause, at any strength."""
    yield Cause(
        "anisotropic highlight",
        (measured.streak - 1.0) / (_MOST_STREAK - 1.0),
        f"the highlight is a streak {measured.streak:.1f} times as long as wide: the reflection is "
        "anisotropic, as of brushed metal, which the maps cannot represent",
        "use an anisotropic shader in the renderer",
        _HIGHLIGHT | {"light", "piece"},
    )
    yield from _of_light(measured)
    yield Cause(
        "steep relief",
        measured.tilt / _MOST_TILT,
        f"the relief's mean slope is {measured.tilt:.0f} degrees, too steep to measure from one "
        "flash position",
        more_photographs(measured.photographs),
        _RELIEF,
    )
    yield Cause(
        "large features",
        (1.0 - measured.variety) / (1.0 - _LEAST_VARIETY),
        "the pattern's features are almost as large as the photograph, too large to rearrange",
        "use it with --variety 0, or photograph more of the sample from further away",
        _DRAWING,
    )


def _of_light(measured: CauseMeasurements) -> Iterator[Cause]:
    """Causes in the light or in how the camera recorded it."""
    even = 0.0 <= measured.side <= _EVEN
    yield Cause(
        "no flash",
        1.0 if even and not measured.fired else 0.0,
        "the flash did not fire: the border is as bright as the middle",
        "photograph again with the flash on, in a dark room",
        _LIGHT,
    )
    yield Cause(
        "light from a side",
        0.0 if even else 1.0 + measured.side / _SIDE_UNIT,
        f"other light from one side, which is {math.exp(measured.side):.1f} times as bright as the "
        "middle",
        DARK,
        _LIGHT,
    )
    bent = measured.developed and measured.curve / _MOST_CURVE >= measured.room / _MOST_ROOM
    yield Cause(
        "room light",
        0.0 if bent else measured.room / _MOST_ROOM,
        f"{min(measured.room, 1.0):.0%} of the light in the dark parts is room light, not the "
        "flash's",
        DARK,
        _LEVELS,
    )
    yield Cause(
        "tone curve",
        measured.curve / _MOST_CURVE if bent else 0.0,
        "the camera applied a tone curve, so that pixel values are not proportional to light",
        "take RAW (DNG)",
        _LEVELS,
    )
    yield Cause(
        "clipping by channel",
        measured.channels / _MOST_CHANNELS,
        f"one or two of red, green and blue are clipped on {100.0 * measured.channels:.0f} % of "
        "the photograph, which changes its colour there",
        "photograph again a stop darker",
        _CLIPPED,
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


def _bent(light: SmoothLight, model: SmoothLight) -> float:
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


def _laid_over(light: SmoothLight, model: SmoothLight) -> float:
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
