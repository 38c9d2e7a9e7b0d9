"""Rotation of a portrait photograph's material to upright.

A capture works in landscape orientation, long side along x. Its results are then rotated 90 degrees
clockwise: the exemplar, indexed again, and the pictures. FlashSetup stays that of the landscape
picture; FlashSetup.turned marks this, and renderers apply it. A decoder's field is not rotated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from matcap.capture.result import CaptureResult
from matcap.example.example import Example
from matcap.flash.render import render_rectified
from matcap.statistics.lattice import Wave

LIES = "The photograph is a portrait: a decoder's maps of it are turned anticlockwise by a quarter."


def upright(result: CaptureResult, waves: Sequence[Wave]) -> CaptureResult:
    """The same capture as its photograph is looked at; itself where that lies already.

    Args:
        result: of a photograph; what is judged of it stays as it is.
        waves: of the photograph's regular order, lying.
    """
    photo, estimate = result.photo, result.estimate
    if not photo.turned:
        return result
    if estimate is None or "example" not in result.material.generators:
        return replace(result, photo=replace(photo, notes=(*photo.notes, LIES)))
    # Columns of the upright picture are rows of the lying one from below, rows are its columns.
    stood = tuple((-wave.fy, wave.fx) for wave in waves)
    example = Example.of(estimate.exemplar.turned(), stood).varied(estimate.example.variety)
    material = replace(
        result.material,
        generators={**result.material.generators, "example": example},
        setup=replace(result.material.setup, turned=True),
    )
    maps = material.maps(*result.maps.size[::-1], seed=result.settings.seed)
    with torch.inference_mode():
        rerendered = render_rectified(maps, material.setup).movedim(0, -1).contiguous().numpy()
    return replace(
        result,
        material=material,
        maps=maps,
        rectified=standing(result.rectified),
        rerendered=rerendered,
        estimate=replace(estimate, example=example, turned=True),
    )


def standing(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """A lying picture (H, W, ...) turned a quarter clockwise."""
    return np.ascontiguousarray(np.rot90(picture, -1))
