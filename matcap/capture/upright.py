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

LIES = "The photograph is a portrait: the decoder's maps are rotated 90 degrees anticlockwise."


def upright(result: CaptureResult, waves: Sequence[Wave]) -> CaptureResult:
    """Rotate a capture to the orientation of its photograph; a landscape one is returned as is.

    Args:
        result: of a photograph; its measurements and verdict are kept.
        waves: frequency vectors of the lattice in landscape orientation, cycles per texel.
    """
    photo, estimate = result.photo, result.estimate
    if not photo.turned:
        return result
    if estimate is None or "example" not in result.material.generators:
        return replace(result, photo=replace(photo, notes=(*photo.notes, LIES)))
    # Columns of the upright picture are rows of the landscape one from below, rows its columns.
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
    """Rotate a picture (H, W, ...) by 90 degrees clockwise."""
    return np.ascontiguousarray(np.rot90(picture, -1))
