"""Measurements of causes of a poor capture, in photograph and re-rendering.

A cause is reported if its measurement exceeds its limit in the table (photo/checks.py).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

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
_CLIP = 0.995  # of the clip level, from which a channel counts as clipped


def measure_causes(
    photo: Photo,
    smooth: tuple[SmoothLight, SmoothLight],
    pictures: tuple[Picture, Picture],
    highlights: tuple[Highlight | None, Highlight | None],
    exemplar: ExemplarMeasurements,
) -> dict[str, float]:
    """Measurement of each cause by its name.

    Args:
        photo: the photograph.
        smooth: (h, w, 3) low-pass filtered photograph and re-rendering on the plane.
        pictures: (H, W, 3) both, unfiltered.
        highlights: of both.
        exemplar: measurements on the exemplar.
    """
    light, model = (each.mean(axis=2) for each in smooth)
    side, room, curve = _brightest_side(light), _ambient_share(light, model), _bent(light, model)
    uniform = 0.0 <= side <= UNIFORM
    # A tone curve or ambient light, whichever is stronger; of a RAW, ambient light.
    room_strength = CAUSES["room light"].strength(room)
    curved = not photo.radiometric and CAUSES["tone curve"].strength(curve) >= room_strength
    clipped = photo.pixels >= _CLIP * photo.headroom
    return {
        "anisotropic highlight": _streak(pictures, highlights),
        "no flash": float(uniform and not photo.flash_fired),
        "light from a side": -math.inf if uniform else side,
        "room light": 0.0 if curved else room,
        "tone curve": curve if curved else 0.0,
        "clipping by channel": float((clipped[..., 1:] != clipped[..., :1]).any(axis=2).mean()),
        "steep relief": exemplar.tilt,
        "large features": exemplar.variety,
    }


def causes(measured: Mapping[str, float], more: str) -> tuple[Cause, ...]:
    """Causes beyond their limits, the strongest first; `more` is which photographs would help."""
    strengths = {name: CAUSES[name].strength(value) for name, value in measured.items()}
    visible = [name for name in strengths if strengths[name] >= 1.0]
    return tuple(
        CAUSES[name].described(measured[name], more)
        for name in sorted(visible, key=lambda name: -strengths[name])
    )


def by_place(difference: SmoothLight) -> SmoothLight:
    """(h, w) projection of a difference on functions that are linear in position or depend on the
    distance from the centre: light varies so, texture hardly does.
    """
    terms = np.concatenate([_plane(difference.shape), _rings(difference.shape)])
    return np.einsum("n,nhw->hw", _coefficients(difference, terms), terms)


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
    """Standard deviation of the part of log(light / model) explained by log model and its square.

    Fitted together with functions linear in position.
    """
    floor = 0.02 * float(np.median(light)) + 1e-6
    difference = np.log((light + floor) / (model + floor))
    level = np.log(model + floor)
    level = (level - level.mean()) / max(float(level.std()), 1e-6)
    bent = np.stack([level, np.square(level)])
    terms = [*bent, *_plane(difference.shape), np.ones_like(difference)]
    curve = np.einsum("n,nhw->hw", _coefficients(difference, np.stack(terms))[:2], bent)
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


def _coefficients(plane: SmoothLight, terms: SmoothLight) -> SmoothLight:
    """(n,) coefficients of the least-squares fit of terms (n, h, w) to a plane (h, w)."""
    flat = terms.reshape(len(terms), -1)
    return np.asarray(np.linalg.lstsq(flat.T, plane.ravel(), rcond=1e-9)[0], np.float64)
