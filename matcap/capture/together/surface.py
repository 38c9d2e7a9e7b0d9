"""The surface whose slopes are told."""

from __future__ import annotations

import torch
from torch import Tensor

from matcap.capture.piece.integrate import integrate
from matcap.capture.together.texels import slopes_of


def surface_of(slopes: Tensor, texel_size: float) -> Tensor:
    """(1, H, W) the height whose central slopes are nearest to slopes (2, H, W).

    Rises between texels are means of two slopes, whose central differences are smoother than the
    slopes: what is lost so is put back.
    """
    height = torch.zeros(1, *slopes.shape[1:])
    for _ in range(4):
        left = (slopes - slopes_of(height, texel_size)).numpy() * texel_size
        across = 0.5 * (left[0][:, 1:] + left[0][:, :-1])
        down = -0.5 * (left[1][1:] + left[1][:-1])
        height = height + torch.from_numpy(integrate(across, down))[None]
    return height
