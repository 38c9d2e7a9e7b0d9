"""The alignment branch: a network that measures the tilt of the plane from a single photograph.

The paper's encoder has a branch for two rotation angles [henzler2021, section "Alignment"]. Here it
is a separate network, because every capture needs the tilt and most need no latent vector. Cues are
the light's falloff, the highlight's position and the texture's foreshortening. The first two depend
on image position, so features are pooled on a grid, and a blurred image is an input of the last
layers. The foreshortening of fine texture is measured separately (convergence.py); a second, small
network weighs the three estimates of each angle. Trained on simulated photographs of known tilt
(lab/matcap_lab/train/alignment.py).

Angles are those of FlashSetup, in radians: positive tilt_x turns the plane's upper edge towards the
camera, positive tilt_y its left edge.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise
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
from matcap.space.convergence import ESTIMATES, convergence
from matcap.space.layers import residual_block
from matcap.space.picture import PICTURE_CHANNELS, picture

WIDTH = 256  # columns of the input image
CONDITIONS = 3  # scalar inputs
UNKNOWN_FOV = 45.0  # degrees: input of a photograph whose field of view is not known
SHIPPED = Path(__file__).parent / "prior" / "weights" / "alignment.safetensors"

_FORMAT = "matcap-alignment-2"
_REMEDY = "install matcap again, or train the branch with `matcap-lab prior align`"
_GRID = (3, 4)  # rows and columns of the pooled features
_BLURRED = (12, 16)  # rows and columns of the pooled picture
_WIDTHS = (32, 48, 64, 64)  # channels of the layers after the first
_UNIT = 0.15  # radians per unit of the last layer's means
_LOG_STD = (math.log(0.002), math.log(0.3))  # limits of the standard deviation, log radians


class TiltMeasurement(NamedTuple):
    """Measured tilt: two independent Gaussians, in radians."""

    x: float
    y: float
    """Means of tilt_x and tilt_y."""
    std_x: float
    std_y: float
    """Their standard deviations."""


class TiltEvidence(NamedTuple):
    """What a photograph says of its tilt: the branch's inputs."""

    picture: Tensor
    """(PICTURE_CHANNELS, h, WIDTH) of picture.picture()."""
    conditions: Tensor
    """(CONDITIONS,) of conditions()."""
    slopes: Tensor
    """(ESTIMATES, 4) of convergence(), times the camera's distance: tangents."""


class Fusion(nn.Module):
    """Weighs the picture's angles and those of convergence, both axes by the same weights."""

    def __init__(self) -> None:
        super().__init__()
        sources = 1 + ESTIMATES
        inputs = 4 * sources + 2 + CONDITIONS + 1
        self.layers = nn.Sequential(
            *(nn.Linear(inputs, 48), nn.Tanh(), nn.Linear(48, 24), nn.Tanh()),
            nn.Linear(24, sources + 2),
        )

    def forward(
        self, mean: Tensor, log_std: Tensor, conditions: Tensor, slopes: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Means and log standard deviations of (tilt_x, tilt_y), (B, 2) each, in radians.

        Args:
            mean, log_std: (B, 2) of the picture.
            conditions: (B, CONDITIONS).
            slopes: (B, ESTIMATES, 4) as in TiltEvidence.
        """
        angles = torch.stack([slopes[..., 1], -slopes[..., 0]], dim=-1).atan().clamp(-0.35, 0.35)
        own = torch.cat([mean[:, None], angles], dim=1) / _UNIT
        certain = torch.cat([log_std[:, None], slopes[..., 2:].flip(-1).log()], dim=1) + 3.5
        gap = (own[:, 1:2] - own[:, 2:3]).abs()
        each = torch.cat([own, certain, gap], dim=1)
        other = torch.cat([own.abs(), certain, gap], dim=1).flip(-1)
        axis = torch.tensor([[0.0, 1.0]]).expand(len(mean), 1, 2)
        shared = conditions[..., None].expand(-1, -1, 2)
        out = self.layers(torch.cat([each, other, shared, axis], dim=1).transpose(1, 2))
        weights = (out[..., :-2] + torch.tensor([1.0] + [0.0] * ESTIMATES)).softmax(-1)
        fused = (weights * own.transpose(1, 2)).sum(-1) + 0.3 * out[..., -2]
        return _UNIT * fused, (out[..., -1] + math.log(0.1)).clamp(*_LOG_STD)


class PictureTilt(nn.Module):
    """The network of pictures: image and scalar inputs to two tilt angles."""

    def __init__(self) -> None:
        super().__init__()
        self.features = nn.Sequential(
            nn.Conv2d(PICTURE_CHANNELS, 16, 5, 2, 2),
            nn.ReLU(inplace=True),
            *(residual_block(before, width, 2) for before, width in pairwise((16, *_WIDTHS))),
        )
        inputs = _WIDTHS[-1] * _GRID[0] * _GRID[1] + 3 * _BLURRED[0] * _BLURRED[1] + CONDITIONS
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


class Alignment(nn.Module):
    """The branch: a network of pictures, and the fusion of its angles with convergence."""

    def __init__(self) -> None:
        super().__init__()
        self.picture, self.fusion = PictureTilt(), Fusion()

    def forward(self, seen: TiltEvidence) -> tuple[Tensor, Tensor]:
        """Means and log standard deviations of (tilt_x, tilt_y), (1, 2) each, in radians."""
        stated = seen.conditions[None]
        mean, log_std = self.picture(seen.picture[None], stated)
        return self.fusion(mean, log_std, stated, seen.slopes[None])


def conditions(fov: Tensor, known: Tensor, radiometric: Tensor) -> Tensor:
    """(B, CONDITIONS) scalar inputs.

    Args:
        fov: (B,) degrees across the long side.
        known: (B,) bool, whether the field of view is from metadata rather than assumed.
        radiometric: (B,) bool, whether the photograph is RAW.
    """
    return torch.stack([(fov - 60.0) / 15.0, known.float(), radiometric.float()], dim=1)


def evidence(photo: Photo) -> TiltEvidence:
    """The branch's inputs of a photograph; pixels of its left_out mask become the median colour."""
    pixels = photo.pixels
    if photo.left_out is not None and not photo.left_out.all():
        out = photo.left_out[..., None]
        pixels = np.where(out, np.median(pixels[~photo.left_out], axis=0), pixels)
    known = photo.fov_source != "assumed"
    stated = conditions(
        torch.tensor([photo.fov if known else UNKNOWN_FOV]),
        torch.tensor([known]),
        torch.tensor([photo.radiometric]),
    )
    slopes = convergence(pixels) / math.tan(math.radians(photo.fov / 2.0))
    return TiltEvidence(picture(pixels, WIDTH), stated[0].float(), slopes)


def tilt_measurement(photo: Photo, branch: Alignment | None = None) -> TiltMeasurement:
    """Measure a photograph's tilt with its standard deviation, in radians.

    Args:
        photo: any size.
        branch: the networks; None is those shipped with matcap.

    Raises:
        MatcapError: the shipped networks are missing or damaged.
    """
    with torch.inference_mode():
        mean, log_std = (branch or _shipped())(evidence(photo))
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
    try:
        with safe_open(path, framework="pt") as file:
            if (file.metadata() or {}).get("matcap") != _FORMAT:
                raise MatcapError.at(path, f"this is not an alignment branch ({_FORMAT})", _REMEDY)
            return StoredTensors(file, path, _REMEDY).load(Alignment())
    except (SafetensorError, OSError) as error:
        raise MatcapError.at(
            path, f"the alignment branch cannot be read ({error})", _REMEDY
        ) from error
