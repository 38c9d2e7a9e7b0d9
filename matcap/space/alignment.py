"""The alignment branch: a network that measures the tilt of the plane from a single photograph.

The paper's encoder has a branch for two rotation angles [henzler2021, section "Alignment"]. Here it
is a separate network, because every capture needs the tilt and most need no latent vector. Cues are
the light's falloff, the highlight's position and the texture's foreshortening. The first two depend
on image position, so features are pooled on a grid, and a blurred image is an input of the last
layers. Trained on simulated photographs of known tilt (lab/train/align.py).

Angles are those of FlashSetup, in radians: positive tilt_x turns the plane's upper edge towards the
camera, positive tilt_y its left edge.
"""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from matcap.errors import MatcapError
from matcap.files.tensors import StoredTensors, write_tensors
from matcap.photo.photo import Photo
from matcap.space.picture import PICTURE_CHANNELS, picture
from matcap.space.residual import ResidualBlock

WIDTH = 256  # columns of the input image
CONDITIONS = 3  # scalar inputs
UNKNOWN_FOV = 45.0  # degrees: input of a photograph whose field of view is not known
SHIPPED = Path(__file__).parent / "prior" / "weights" / "alignment.safetensors"

_FORMAT = "matcap-alignment-1"
_REMEDY = "install matcap again, or train the branch with `matcap prior align`"
_GRID = (3, 4)  # rows and columns of the pooled features
_BLURRED = (12, 16)  # rows and columns of the pooled picture
_WIDTHS = (32, 48, 64, 64)  # channels of the layers after the first
_UNIT = 0.15  # radians per unit of the last layer's means
_LOG_STD = (math.log(0.002), math.log(0.3))  # limits of the standard deviation, log radians


class TiltMeasurement(NamedTuple):
    """Measured tilt: two independent Gaussians, in radians.

    Attributes:
        x, y: means of tilt_x and tilt_y.
        std_x, std_y: their standard deviations.
    """

    x: float
    y: float
    std_x: float
    std_y: float


class Alignment(nn.Module):
    """The network: image and scalar inputs to two tilt angles."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = [nn.Conv2d(PICTURE_CHANNELS, 16, 5, 2, 2), nn.ReLU(inplace=True)]
        channels = 16
        for width in _WIDTHS:
            layers.append(ResidualBlock(channels, width, 2))
            channels = width
        self.features = nn.Sequential(*layers)
        inputs = channels * _GRID[0] * _GRID[1] + 3 * _BLURRED[0] * _BLURRED[1] + CONDITIONS
        self.hidden = nn.Sequential(
            nn.Linear(inputs, 192), nn.ReLU(), nn.Linear(192, 64), nn.ReLU()
        )
        self.head = nn.Linear(64, 4)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def forward(self, pictures: Tensor, conditions: Tensor) -> tuple[Tensor, Tensor]:
        """Means and log standard deviations of (tilt_x, tilt_y), (B, 2) each, in radians.

        Args:
            pictures: (B, PICTURE_CHANNELS, h, WIDTH) from picture.picture().
            conditions: (B, CONDITIONS) from conditions().
        """
        features = self.features(pictures.contiguous(memory_format=torch.channels_last))
        pooled = F.adaptive_avg_pool2d(features, _GRID).float().flatten(1)
        blurred = F.adaptive_avg_pool2d(pictures[:, :3].float(), _BLURRED).flatten(1)
        hidden = self.hidden(torch.cat([pooled, blurred, conditions], dim=1))
        mean, log_std = self.head(hidden).float().chunk(2, dim=1)
        return _UNIT * mean, (log_std + math.log(0.1)).clamp(*_LOG_STD)


def conditions(fov: Tensor, known: Tensor, radiometric: Tensor) -> Tensor:
    """(B, CONDITIONS) scalar inputs.

    Args:
        fov: (B,) degrees across the long side.
        known: (B,) bool, whether the field of view is from metadata rather than assumed.
        radiometric: (B,) bool, whether the photograph is RAW.
    """
    return torch.stack([(fov - 60.0) / 15.0, known.float(), radiometric.float()], dim=1)


def tilt_measurement(photo: Photo, branch: Alignment | None = None) -> TiltMeasurement:
    """Measure a photograph's tilt with its standard deviation, in radians.

    Args:
        photo: any size; pixels of its left_out mask are replaced by the median colour.
        branch: the network; None is the one shipped with matcap.

    Raises:
        MatcapError: the shipped network is missing or damaged.
    """
    pixels = photo.pixels
    if photo.left_out is not None and not photo.left_out.all():
        out = photo.left_out[..., None]
        pixels = np.where(out, np.median(pixels[~photo.left_out], axis=0), pixels)
    known = photo.fov_source != "assumed"
    known_conditions = conditions(
        torch.tensor([photo.fov if known else UNKNOWN_FOV]),
        torch.tensor([known]),
        torch.tensor([photo.radiometric]),
    )
    with torch.inference_mode():
        mean, log_std = (branch or _shipped())(
            picture(pixels, WIDTH)[None], known_conditions.float()
        )
    (x, y), (std_x, std_y) = mean[0].tolist(), log_std[0].exp().tolist()
    return TiltMeasurement(x, y, std_x, std_y)


@lru_cache(maxsize=1)
def _shipped() -> Alignment:
    return load_alignment(SHIPPED)


def save_alignment(path: Path, branch: Alignment) -> None:
    """Write the network in half precision, atomically."""
    tensors = {name: tensor.half() for name, tensor in branch.state_dict().items()}
    write_tensors(path, tensors, {"matcap": _FORMAT})


def load_alignment(path: Path) -> Alignment:
    """Read the network.

    Raises:
        MatcapError: the file is missing, damaged or of another kind.
    """
    branch = Alignment()
    try:
        with safe_open(path, framework="pt") as file:
            if (file.metadata() or {}).get("matcap") != _FORMAT:
                raise MatcapError(
                    f"this is not an alignment branch ({_FORMAT})",
                    where=str(path),
                    remedy=_REMEDY,
                )
            stored = StoredTensors(file, path, _REMEDY)
            branch.load_state_dict(
                {
                    name: stored.tensor(name, tuple(value.shape))
                    for name, value in branch.state_dict().items()
                },
                assign=True,
            )
    except (SafetensorError, OSError) as error:
        raise MatcapError(
            f"the alignment branch cannot be read ({error})", where=str(path), remedy=_REMEDY
        ) from error
    return branch.eval().requires_grad_(False)
