"""The inverse network, a U-Net from a flash photograph to log-parameter residuals; its inputs."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Self

import torch
import torch.nn.functional as F
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from matcap.brdf.cook_torrance import ALBEDO, SurfaceParameters
from matcap.brdf.maps import CHANNELS
from matcap.errors import MatcapError
from matcap.files.tensors import StoredTensors
from matcap.files.threads import one_thread
from matcap.flash.geometry import camera_in_plane
from matcap.flash.light import FlashLight, Uniform, uniform_radiance

# A U-Net from a flash photograph to log-parameter residuals from a uniform material.
#
# Levels have half the picture's resolution and less, the finest with 2 x 2 texels as channels; four
# convolutions at full resolution follow, by which little has a period of 2 texels. Fully
# convolutional; information needed across the whole picture (gloss at the rim, relief in the
# middle) goes through a pooled context: means of every level's features, uniform and weighted by
# the sensitivity to slope and by gloss, scale and shift the features of the decoder (FiLM
# [perez2018]).

_WEIGHTINGS = 3  # of the context's means: uniform, by squared slope sensitivity, by gloss
_SLOPE = 0.2  # of LeakyReLU
_SELDOM_METAL = -3.0  # initial bias of the logit of metal
_GROUPS = 4  # of GroupNorm
_FINE = 32  # channels at full resolution
_STRIP, _HALO = 64, 3  # rows at half the resolution of a strip, and beyond it that it reads

# File of the network: weights in half precision, and a model card.
FORMAT = "matcap-inverse"
VERSION = 3  # of the file
SHIPPED = Path(__file__).parent / "weights" / "inverse.safetensors"
_WIDEST, _DEEPEST = 512, 8
_REMEDY = "install matcap again, or give another file"


@dataclass(frozen=True)
class InverseConfig:
    """Widths of the network's layers."""

    widths: tuple[int, ...] = (32, 48, 64, 96, 128)
    """Channels at 1/2, 1/4, ... of the picture's resolution."""
    context: int = 96
    """Channels of the pooled context."""

    @property
    def multiple(self) -> int:
        """Sides of the input must be multiples of this."""
        return 2 ** len(self.widths)


class _NamedPlanes:
    """Planes of a tensor by name, (..., C, H, W) each."""

    channels: ClassVar[tuple[int, ...]]
    """C of each, in order."""

    def stacked(self) -> Tensor:
        """All planes concatenated, (..., sum of C, H, W)."""
        return torch.cat(list(vars(self).values()), dim=-3)

    @classmethod
    def from_stacked(cls, stacked: Tensor) -> Self:
        """The inverse of stacked()."""
        return cls(*stacked.split(cls.channels, dim=-3))


@dataclass(frozen=True)
class NetworkInputs(_NamedPlanes):
    """Inputs of the network."""

    channels = (3, 1, 2, 2, 1, 1, 3, 2)

    log: Tensor
    """Log radiance over the uniform material's, 3 channels."""
    valid: Tensor
    """1 where visible and not clipped, else 0."""
    tangent: Tensor
    """x / z and y / z of the direction to the light."""
    slope_sensitivity: Tensor
    """d log L / d slope along x and y."""
    roughness_sensitivity: Tensor
    """d log L / d logit(roughness)."""
    gloss: Tensor
    """Specular fraction of the uniform material's radiance, in [0, 1]."""
    uniform: Tensor
    """The uniform material's logit of roughness, log F0 and log albedo, scaled; constant planes."""
    relief: Tensor
    """First-order estimate of the slope along x and y from log radiance."""


@dataclass(frozen=True)
class ExpectedErrors(_NamedPlanes):
    """Logarithms of the expected absolute errors of a prediction."""

    channels = (1, 1, 1, 1)

    albedo: Tensor
    """Log of the error of log albedo."""
    specular: Tensor
    """Log of the error of log F0."""
    roughness: Tensor
    """Log of the error of logit roughness."""
    slope: Tensor
    """Log of the error of slopes."""


INPUTS, ERRORS = sum(NetworkInputs.channels), sum(ExpectedErrors.channels)
OUTPUTS = sum(CHANNELS.values())
_HEIGHT = slice(OUTPUTS - 1, OUTPUTS)  # the last of the residuals
ANSWERS = OUTPUTS + ERRORS + 1  # the last is the logit of metal


@dataclass(frozen=True)
class NetworkAnswer:
    """Output of the network."""

    residuals: SurfaceParameters
    """Log parameters of the maps less those of the uniform material; F0 is its channels' mean."""
    errors: ExpectedErrors
    """Their expected errors."""
    metal: Tensor
    """(..., 1, H, W) logit of the share of metal in each texel (predict.py)."""

    @staticmethod
    def from_stacked(stacked: Tensor) -> NetworkAnswer:
        """Split the output tensor (..., ANSWERS, H, W)."""
        residuals, errors, metal = stacked.split([OUTPUTS, ERRORS, 1], dim=-3)
        return NetworkAnswer(
            SurfaceParameters.from_stacked(residuals), ExpectedErrors.from_stacked(errors), metal
        )


class Inverse(nn.Module):
    """The network; see the module."""

    def __init__(self, config: InverseConfig = InverseConfig()) -> None:
        super().__init__()
        self.config = config
        widths = config.widths
        self.stem = nn.Conv2d(4 * INPUTS, widths[0], 3, padding=1)
        before = (widths[0], *widths[:-1])
        self.down = nn.ModuleList(
            _ResidualBlock(last, width) for last, width in zip(before, widths, strict=True)
        )
        self.pooled = nn.ModuleList(nn.Linear(_WEIGHTINGS * w, config.context) for w in widths)
        self.context = nn.Sequential(
            nn.LeakyReLU(_SLOPE), nn.Linear(config.context, config.context), nn.LeakyReLU(_SLOPE)
        )
        self.merge = nn.ModuleList(
            nn.Conv2d(width + above, width, 1)
            for width, above in zip(widths[:-1], widths[1:], strict=True)
        )
        self.up = nn.ModuleList(_ResidualBlock(width, width) for width in widths[:-1])
        self.modulation = nn.ModuleList(nn.Linear(config.context, 2 * w) for w in widths[:-1])
        self.heights = nn.ModuleList(nn.Conv2d(width, 1, 3, padding=1) for width in widths[:-1])
        self.head = nn.Conv2d(widths[0], 4 * _FINE, 3, padding=1)
        self.fine = nn.Conv2d(_FINE + INPUTS, _FINE, 3, padding=1)
        self.finer = nn.ModuleList(nn.Conv2d(_FINE, _FINE, 3, padding=1) for _ in range(2))
        self.out = nn.Conv2d(_FINE, ANSWERS, 3, padding=1)
        with torch.no_grad():
            for layer in (self.out, *self.heights, *self.modulation):
                layer.weight.mul_(0.1)
                assert layer.bias is not None
                layer.bias.zero_()
            assert self.out.bias is not None
            self.out.bias[-1] = _SELDOM_METAL

    def forward(self, inputs: Tensor) -> Tensor:
        """Predict the maps of a batch of photographs.

        Args:
            inputs: (B, INPUTS, H, W), sides multiples of config.multiple.

        Returns:
            (B, ANSWERS, H, W), to be split by NetworkAnswer.from_stacked.
        """
        parts = NetworkInputs.from_stacked(inputs)
        weights = _weightings(parts)
        x = F.conv2d(inputs, _of_texels(self.stem.weight), self.stem.bias, stride=2, padding=2)
        levels, context = [], 0.0
        for index, (block, pooled) in enumerate(zip(self.down, self.pooled, strict=True)):
            if index:
                x = F.avg_pool2d(x, 2)
            weights = F.avg_pool2d(weights, 2)
            x = block(x)
            levels.append(x)
            context = context + pooled(_means(x, weights))
        context = self.context(context)
        height: Tensor | None = None
        levels.pop()  # each is freed once it is used, as all of a level's size are many
        for index in reversed(range(len(levels))):
            # A 1 x 1 convolution of the level and of what is enlarged; enlarged after it.
            merge, width = self.merge[index], self.config.widths[index]
            assert isinstance(merge, nn.Conv2d)
            x = _doubled(F.conv2d(x, merge.weight[:, width:], merge.bias))
            x = x.add_(F.conv2d(levels.pop(), merge.weight[:, :width]))
            scale, shift = self.modulation[index](context)[..., None, None].chunk(2, dim=1)
            x = torch.addcmul(shift, x, 1.0 + scale)
            x = self.up[index](x)
            # Heights are proportional to the wavelength at equal slope.
            here = self.heights[index](x) * 2.0**index
            height = here if height is None else here + _doubled(height)
        assert height is not None
        # Full resolution takes most of the memory: by strips of rows, each with all that it reads.
        rows = x.shape[-2]
        answer = x.new_empty(len(x), ANSWERS, 2 * rows, 2 * x.shape[-1])
        for top in range(0, rows, _STRIP):
            first, last = max(0, top - _HALO), min(rows, top + _STRIP + _HALO)
            fine = self._fine(x[:, :, first:last], inputs[:, :, 2 * first : 2 * last])
            end = min(top + _STRIP, rows)
            answer[:, :, 2 * top : 2 * end] = fine[:, :, 2 * (top - first) : 2 * (end - first)]
        # Albedo is predicted relative to the photograph's log radiance over the uniform material.
        answer[:, ALBEDO] += parts.log
        answer[:, _HEIGHT] += _doubled(height)
        return answer

    def _fine(self, x: Tensor, inputs: Tensor) -> Tensor:
        """(B, ANSWERS, H, W) of features at half the resolution, and inputs."""
        # A convolution of features and inputs, without a copy of both side by side.
        weight, features = self.fine.weight, F.pixel_shuffle(self.head(x), 2)
        fine = F.conv2d(features, weight[:, :-INPUTS], self.fine.bias, padding=1)
        fine = fine.add_(F.conv2d(inputs, weight[:, -INPUTS:], padding=1))
        fine = F.leaky_relu(fine, _SLOPE, inplace=True)
        for finer in self.finer:
            fine = fine + F.leaky_relu(finer(fine), _SLOPE, inplace=True)
        answer: Tensor = self.out(fine)
        return answer


class _ResidualBlock(nn.Module):
    """Two convolutions, each after GroupNorm and LeakyReLU, plus a shortcut."""

    def __init__(self, before: int, width: int) -> None:
        super().__init__()
        self.before = nn.GroupNorm(_GROUPS, before)
        self.first = nn.Conv2d(before, width, 3, padding=1)
        self.between = nn.GroupNorm(_GROUPS, width)
        self.second = nn.Conv2d(width, width, 3, padding=1)
        self.shortcut = nn.Conv2d(before, width, 1) if before != width else nn.Identity()
        with torch.no_grad():
            self.second.weight.mul_(0.3)

    def forward(self, x: Tensor) -> Tensor:
        with one_thread():  # sums over the picture, in an order that depends on it
            y = self.before(x)
        y = self.first(F.leaky_relu(y, _SLOPE, inplace=True))
        with one_thread():
            y = self.between(y)
        return self.second(F.leaky_relu(y, _SLOPE, inplace=True)).add_(self.shortcut(x))


def _doubled(planes: Tensor) -> Tensor:
    """(B, C, 2 H, 2 W) bilinear enlargement."""
    return F.interpolate(planes, scale_factor=2.0, mode="bilinear", align_corners=False)


def _of_texels(weight: Tensor) -> Tensor:
    """(O, C, 6, 6) weight on texels, of stride 2, of a weight (O, 4 C, 3, 3) on 2 x 2 of them."""
    count = weight.shape[1] // 4
    return weight.unflatten(1, (count, 2, 2)).permute(0, 1, 4, 2, 5, 3).reshape(-1, count, 6, 6)


def _weightings(parts: NetworkInputs) -> Tensor:
    """(B, _WEIGHTINGS, H, W) weights of valid texels: 1, squared slope sensitivity, gloss."""
    valid = parts.valid + 1e-3
    relief = parts.slope_sensitivity.square().sum(1, keepdim=True)
    return torch.cat([valid, valid * relief, valid * parts.gloss], dim=1)


@one_thread()
def _means(features: Tensor, weights: Tensor) -> Tensor:
    """(B, _WEIGHTINGS * C) weighted means of |features| (B, C, H, W)."""
    total = weights.sum((2, 3)).clamp_min(1e-6)
    means = torch.einsum("bchw,bkhw->bkc", features.abs(), weights) / total[..., None]
    return means.flatten(1)


def read_inverse(path: Path) -> tuple[Inverse, dict[str, Any]]:
    """Read a network and its model card.

    Raises:
        MatcapError: the file is missing, damaged, or of another format or version.
    """
    try:
        with safe_open(path, framework="pt") as file:
            about = json.loads((file.metadata() or {})["matcap"])
            if about["format"] != FORMAT or about["version"] != VERSION:
                raise ValueError(f"it holds {about['format']} of version {about['version']}")
            widths = tuple(int(width) for width in about["widths"])
            sizes = (*widths, int(about["context"]))
            if not (2 <= len(widths) <= _DEEPEST and all(4 <= s <= _WIDEST for s in sizes)):
                raise ValueError(f"a network of widths {sizes}")
            network = Inverse(InverseConfig(widths, int(about["context"])))
            network = StoredTensors(file, path, _REMEDY).load(network)
    except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
        raise MatcapError.at(
            path, "this is not an inverse network's file, or it is damaged", _REMEDY
        ) from error
    return network, dict(about["card"])


@cache
def load_inverse() -> Inverse:
    """Load the network that comes with matcap, once per process."""
    return read_inverse(SHIPPED)[0]


# Inputs of the inverse network.
#
# The photograph enters as the logarithm of its radiance over that of a uniform material in the same
# setup (the coarse fit), and the setup as its sensitivities: the derivatives of log radiance by
# slope and by roughness at every texel. So one network serves every field of view, flash and tilt.
# Heights are in texels, so slopes are rise over run at any resolution.

MOST_RESIDUAL = 3.0  # log radiance; residuals are clipped to +-this
_STEP = 0.03  # step of slope and of logit roughness in finite differences of radiance
SUBSAMPLING = 4  # subsampling, texels, of renderings of the uniform material, which are smooth
_DAMPING = 0.1  # regularises the first-order slope estimate where the sensitivity vanishes


def network_inputs(
    linear: Tensor, valid: Tensor, uniform: Uniform, points: Tensor
) -> NetworkInputs:
    """Compute the network's inputs for a picture on the plane's grid.

    Args:
        linear: (3, H, W) scene-linear radiance.
        valid: (H, W) bool, visible and not clipped.
        points: (3, H, W) plane points of the texels (flash.geometry.plane_points).
    """
    height, width = linear.shape[-2:]
    size = tuple(max(2, -(-side // SUBSAMPLING)) for side in (height, width))
    # A coarse grid from the first to the last texel, whose points are linear in the index.
    thin = resized(points, size)
    light = FlashLight.of(uniform.setup, thin)
    flat, diffuse = uniform_radiance(uniform, light)
    _, flash = (v.to(points)[:, None, None] for v in camera_in_plane(uniform.setup))
    smooth = {
        "flat": flat.log(),
        "tangent": (flash - thin)[:2] / (flash - thin)[2:],
        "slope": _shown_of_slope(uniform, light),
        "roughness": _shown_of_roughness(uniform, light, flat),
        "gloss": 1.0 - diffuse.mean(0, keepdim=True) / flat.mean(0, keepdim=True),
    }
    channels = [len(plane) for plane in smooth.values()]
    planes = resized(torch.cat(list(smooth.values())), (height, width)).split(channels)
    everywhere = dict(zip(smooth, planes, strict=True))
    log = (linear.clamp_min(1e-6).log() - everywhere["flat"]).clamp(-MOST_RESIDUAL, MOST_RESIDUAL)
    sensitivity = everywhere["slope"]
    # To first order: the slope along the gradient that this residual of log radiance implies.
    steep = sensitivity.square().sum(0, keepdim=True) + _DAMPING**2
    relief = log.mean(0, keepdim=True) * sensitivity / steep
    constants = torch.tensor(
        [
            float(uniform.parameters().roughness) / 2.0,
            (math.log(uniform.specular) + 3.0) / 2.0,
            (math.log(sum(uniform.diffuse) / 3.0) + 1.5) / 2.0,
        ]
    ).to(points)
    return NetworkInputs(
        log=log,
        valid=valid[None].to(log),
        tangent=everywhere["tangent"],
        slope_sensitivity=sensitivity.clamp(-4.0, 4.0),
        roughness_sensitivity=everywhere["roughness"].clamp(-2.0, 2.0),
        gloss=everywhere["gloss"],
        uniform=constants[:, None, None].expand(3, height, width),
        relief=relief.clamp(-3.0, 3.0) * 0.5,
    )


def _shown_of_slope(uniform: Uniform, light: FlashLight) -> Tensor:
    """(2, h, w) d log L / d slope along x and y, by central differences."""
    # One call for all four, as calls dominate the time of small tensors.
    moves = torch.tensor([[_STEP, 0.0], [-_STEP, 0.0], [0.0, _STEP], [0.0, -_STEP]])
    flat = torch.zeros_like(light.to_light[:1])
    across, up = (move.to(flat)[:, None, None, None] + flat for move in moves.T)
    moved = uniform_radiance(uniform, light, (across, up))[0]
    right, left, above, below = moved.mean(1, keepdim=True).log()
    return torch.cat([right - left, above - below]) / (2.0 * _STEP)


def _shown_of_roughness(uniform: Uniform, light: FlashLight, flat: Tensor) -> Tensor:
    """(1, h, w) d log L / d logit(roughness), by a forward difference from `flat` (3, h, w)."""
    duller = uniform_radiance(uniform, light, duller=_STEP)[0]
    return (duller.mean(0, keepdim=True).log() - flat.mean(0, keepdim=True).log()) / _STEP


def resized(picture: Tensor, size: tuple[int, ...]) -> Tensor:
    """Resize (C, H, W) bilinearly to (C, *size), with corners aligned."""
    return F.interpolate(picture[None], size=list(size), mode="bilinear", align_corners=True)[0]
