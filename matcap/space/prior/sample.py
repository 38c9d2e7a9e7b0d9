"""Contact sheet of materials."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.field.material import Material
from matcap.flash.render import render_rectified

_COLUMNS = 4  # materials in a row
_BRIGHTNESS = 0.25  # mean radiance of every tile


def flash_picture(material: Material, size: int, seed: int) -> Tensor:
    """(3, size, size) radiance of a material under its own flash, seen from straight above."""
    maps = material.maps(size, size, seed=seed)
    with torch.inference_mode():
        return render_rectified(maps, material.setup)


def sample_sheet(materials: Sequence[Material], seed: int, size: int = 256) -> NDArray[np.float32]:
    """(rows * size, columns * size, 3) linear image, each material rendered under its own flash.

    Args:
        materials: at least one.
        seed: of the first material's field; each next one adds 1.
        size: texels a side of a tile.
    """
    count = len(materials)
    tiles = []
    for index, material in enumerate(materials):
        picture = flash_picture(material, size, seed + index)
        exposed = picture * (_BRIGHTNESS / picture.mean().clamp_min(1e-6))
        tiles.append(exposed.clamp(0.0, 1.0).permute(1, 2, 0).numpy())
    columns = min(_COLUMNS, count)
    blank = np.zeros_like(tiles[0])
    rows = [
        np.concatenate([*row, *([blank] * (columns - len(row)))], axis=1)
        for row in (tiles[i : i + columns] for i in range(0, count, columns))
    ]
    return np.concatenate(rows, axis=0)
