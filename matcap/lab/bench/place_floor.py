"""How well one photograph can tell where flash and plane were, however it is fitted.

The Cramer-Rao bound: light changes with offset and tilt by so much, and with albedo, gloss and
vignetting, which are not known either; the texture is noise, as strong as its own slow variation.
It holds for what is smooth. What it leaves out: texture's foreshortening, and gleams of single
grains.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.flash.coarse import CoarseFit, render_coarse
from matcap.flash.geometry import FlashSetup
from matcap.photo.photo import Photo

Array = NDArray[np.float64]

_CELLS, _BLOCK = (48, 36), 4  # across and down; blocks of cells whose means tell slow variation
_CLIPPED = 0.95  # of the clip level: brighter cells tell nothing
_MOST = 1.0  # log radiance: larger residuals count as this large
_MODEL = 0.001  # log radiance, of a cell: no model of light is better
_BLACK = 1e-9  # diffuse albedo
_STEP = 1e-4  # of an unknown, all of which are of order 1
# What is known before, deviations: log albedo; log F0 and logit roughness of two lobes; offset
# (plane units) and tilt (radians) as bench/highlight.py draws them; vignetting.
_KNOWN = (*[5.0] * 3, *[1.0, 1.5] * 2, *[0.086] * 2, *[0.107] * 2, 0.05)
_OFFSET, _TILT = slice(7, 9), slice(9, 11)
_MEDIAN = math.sqrt(2.0 * math.log(2.0))  # of a distance in two directions of deviation 1


@dataclass(frozen=True)
class PlaceFloor:
    """Least median errors: of the offset (plane units) and of the tilt (degrees)."""

    offset: float
    tilt: float


def place_floors(photo: Photo, fit: CoarseFit, truth: FlashSetup) -> tuple[PlaceFloor, PlaceFloor]:
    """Floors of a simulated photograph, from its brightness alone and from all its channels.

    Args:
        photo: whose cells' residuals to the fit are the texture.
        fit: its coarse fit.
        truth: its setup, where derivatives are taken.
    """
    small = cv2.resize(photo.pixels, _CELLS, interpolation=cv2.INTER_AREA).astype(np.float64)
    seen = small.max(axis=2).ravel() < _CLIPPED
    found = _lobes(fit)
    rest = np.log(np.maximum(small, 1e-6)).reshape(-1, 3) - _log(found)
    noise = _slow(_texture(np.clip(rest, -_MOST, _MOST), _derivatives(found), seen))
    setup = replace(fit.setup, offset=truth.offset, tilt=truth.tilt)
    change = _derivatives([replace(lobe, setup=setup) for lobe in found])[:, seen]
    brightness = change.mean(axis=2)
    alike = brightness @ brightness.T / (noise.mean() + _MODEL**2)
    inverse = np.linalg.inv(noise + _MODEL**2 * np.eye(3))
    whole = np.einsum("inc,cd,jnd->ij", change, inverse, change)
    return _floor(alike), _floor(whole)


def _lobes(fit: CoarseFit) -> list[CoarseFit]:
    """A uniform material of each lobe, whose light adds up to the fit's; the first is diffuse."""
    parts = [
        replace(fit, specular=fit.specular * share, roughness=roughness)
        for share, roughness in fit.lobes
    ]
    dark = (_BLACK, _BLACK, _BLACK)
    return [parts[0], *(replace(part, diffuse=dark) for part in parts[1:])]


def _texture(rest: Array, change: Array, seen: NDArray[np.bool_]) -> Array:
    """(cells, 3) residuals without what a better fit of the same kind would explain; 0 unseen."""
    flat, kept = change[:, seen].reshape(len(_KNOWN), -1), rest[seen]
    normal = flat @ flat.T + np.diag(1e-6 * np.ones(len(_KNOWN)))
    explained = flat.T @ np.linalg.solve(normal, flat @ kept.ravel())
    texture = np.zeros_like(rest)
    texture[seen] = kept - explained.reshape(-1, 3)
    return texture


def _slow(texture: Array) -> Array:
    """(3, 3) covariance of a cell's channels (cells, 3) in what means of blocks still have."""
    columns, rows = _CELLS[0] // _BLOCK, _CELLS[1] // _BLOCK
    means = texture.reshape(rows, _BLOCK, columns, _BLOCK, 3).mean(axis=(1, 3)).reshape(-1, 3)
    covariance = means.T @ means / len(means) * _BLOCK**2
    return np.asarray(covariance, np.float64)


def _derivatives(lobes: Sequence[CoarseFit]) -> Array:
    """(unknowns, cells, 3) of log radiance, in the order of _KNOWN."""
    moved = [step * row for row in np.eye(len(_KNOWN)) for step in (_STEP, -_STEP)]
    logs = [_log([_moved(lobe, n, by.tolist()) for n, lobe in enumerate(lobes)]) for by in moved]
    return (np.stack(logs[::2]) - np.stack(logs[1::2])) / (2.0 * _STEP)


def _log(lobes: Sequence[CoarseFit]) -> Array:
    """(cells, 3) log of the light of all lobes together."""
    light = np.sum([render_coarse(lobe, *_CELLS) for lobe in lobes], axis=0)
    return np.asarray(np.log(light), np.float64).reshape(-1, 3)


def _moved(lobe: CoarseFit, number: int, by: Sequence[float]) -> CoarseFit:
    """A lobe, the first or the second, with its unknowns moved, in the order of _KNOWN."""
    gloss, rough = by[3 + 2 * number : 5 + 2 * number]
    logit = math.log(lobe.roughness / (1.0 - lobe.roughness)) + rough
    red, green, blue = (
        albedo * math.exp(step) for albedo, step in zip(lobe.diffuse, by[:3], strict=True)
    )
    setup = lobe.setup
    x, y, z = setup.offset
    return replace(
        lobe,
        diffuse=(red, green, blue),
        specular=lobe.specular * math.exp(gloss),
        roughness=1.0 / (1.0 + math.exp(-logit)),
        setup=replace(
            setup,
            offset=(x + by[7], y + by[8], z),
            tilt=(setup.tilt[0] + by[9], setup.tilt[1] + by[10]),
            vignetting=setup.vignetting + by[11],
        ),
    )


def _floor(information: Array) -> PlaceFloor:
    covariance = np.linalg.inv(information + np.diag(1.0 / np.square(_KNOWN)))
    offset, tilt = covariance[_OFFSET, _OFFSET], covariance[_TILT, _TILT]
    return PlaceFloor(
        _MEDIAN * math.sqrt(float(np.trace(offset)) / 2.0),
        math.degrees(_MEDIAN * math.sqrt(float(np.trace(tilt)) / 2.0)),
    )
