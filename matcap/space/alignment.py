"""The alignment branch: how far a photograph was tilted, seen from the photograph alone.

Falloff, the highlight's place and the texture's foreshortening all speak of it. The first two
keep their place in the picture, so features are pooled on a grid, not over the whole picture, and
the blurred picture itself is handed on. Trained on simulated photographs of known tilt
(lab/train/align.py). The angles are those of FlashSetup: positive tilt_x turns the plane's upper
edge towards the camera, positive tilt_y its left edge.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from matcap.space.encoder import PICTURE_CHANNELS, ResidualBlock

WIDTH = 256  # picture columns it is shown
_GRID = (3, 4)  # rows and columns of the pooled features
_BLURRED = (12, 16)  # rows and columns of the pooled picture
_WIDTHS = (32, 48, 64, 64)  # channels of the layers after the first
_UNIT = 0.15  # radians: what the last layer calls 1


class Alignment(nn.Module):
    """A photograph (as space/prior/look.py shows it) and its field of view to two tilt angles."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = [nn.Conv2d(PICTURE_CHANNELS, 16, 5, 2, 2), nn.ReLU(inplace=True)]
        channels = 16
        for width in _WIDTHS:
            layers.append(ResidualBlock(channels, width, 2))
            channels = width
        self.features = nn.Sequential(*layers)
        inputs = channels * _GRID[0] * _GRID[1] + 3 * _BLURRED[0] * _BLURRED[1] + 1
        self.hidden = nn.Sequential(
            nn.Linear(inputs, 192), nn.ReLU(), nn.Linear(192, 64), nn.ReLU()
        )
        self.head = nn.Linear(64, 2)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def forward(self, picture: Tensor, fov: Tensor) -> Tensor:
        """(B, 2) tilt_x and tilt_y in radians.

        Args:
            picture: (B, PICTURE_CHANNELS, h, w), WIDTH columns.
            fov: (B,) across the long side, in degrees.
        """
        features = self.features(picture.contiguous(memory_format=torch.channels_last))
        pooled = F.adaptive_avg_pool2d(features, _GRID).float().flatten(1)
        blurred = F.adaptive_avg_pool2d(picture[:, :3].float(), _BLURRED).flatten(1)
        view = ((fov - 60.0) / 15.0)[:, None]
        return _UNIT * self.head(self.hidden(torch.cat([pooled, blurred, view], dim=1))).float()
