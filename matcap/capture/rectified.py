"""A photograph rectified to its sample's plane, after the coarse fit with the alignment branch's
tilt.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.capture.exemplar.network.network import MOST_RESIDUAL, SUBSAMPLING, resized
from matcap.capture.settings import DETAIL
from matcap.field.source import one_thread
from matcap.flash.alignment import tilt_measurement
from matcap.flash.coarse.fit import CoarseFit, fit_coarse, rescale_to_flash
from matcap.flash.geometry import points_of
from matcap.flash.light import FlashLight, Uniform, uniform_radiance
from matcap.flash.rectify import Plane, read_plane
from matcap.photo.left_out import area_averaged, mirrored
from matcap.photo.photo import Photo
from matcap.statistics.compare import FilterBankConfig, Weights
from matcap.statistics.lattice import Wave, find_lattice

WINDOW = 160  # side of the windows whose texture statistics are compared, texels
FEATURES = FilterBankConfig(sizes=(5,), filters=64)


@dataclass(frozen=True)
class Method:
    """A variant of the capture method; by default the one that measured best."""

    weights: Weights = Weights()
    """Weights of the texture statistics in their sum."""
    measured_tilt: bool = True
    """Whether the alignment branch's tilt is a prior of the coarse fit."""


@one_thread()
def fit_photograph(photo: Photo, *, measured: bool = True, metal: bool | None = None) -> CoarseFit:
    """Coarse fit of a photograph, with the alignment branch's two tilt angles as Gaussian prior.

    Albedo is absolute where the flash intensity is known.

    Args:
        measured: whether to use the alignment branch.
        metal: whether the material is metal; None to decide by the photograph.
    """
    prior = tilt_measurement(photo) if measured else None
    fitted = fit_coarse(photo, tilt_prior=prior, known_metal=metal)
    return rescale_to_flash(fitted, photo.flash_intensity)


def tilt_document(coarse: CoarseFit) -> dict[str, Any] | None:
    """Tilt about x and y by source, degrees; None without a measurement.

    Keys: `used`; and `branch`, the alignment branch's, with its standard deviation `branch_std`.
    """
    if coarse.tilt_prior is None:
        return None
    return {
        "used": _degrees(coarse.setup.tilt),
        "branch": _degrees(coarse.tilt_prior.mean),
        "branch_std": _degrees(coarse.tilt_prior.std),
    }


def _degrees(angles: Sequence[float]) -> list[float]:
    return [round(math.degrees(angle), 2) for angle in angles]


# A photograph rectified to the plane of its sample, at the resolutions of exemplar and network.
#
# In come a photograph and its coarse fit, out goes a Rectified: both, the plane, and its lattice.
# The exemplar has the resolution asked for. The network's receptive field is about a hundred texels
# and the compared windows have 160; structure of longer wavelength is lost (wood becomes sawdust).
# Such textures are read on half as many texels across, and finer bands are transferred from the
# photograph (exemplar/detail_transfer.py). Figures in docs/notes/capture.md.

UNION_TIMES = 4  # largest exemplar of several photographs, in texels of the first one's


# Detection of coarse textures; docs/notes/capture.md.

_FAINTEST = 1e-4  # linear radiance below which the logarithm is clamped, as it is noise
_OCTAVES = 6  # number of bands, separated by Gaussian blurs of 1, 2, 4 ... texels
# Share of variance in the last band (wavelengths of 100 to 200 texels) above which a texture is
# coarse.
_MOST_COARSE = 0.08
_MOST_REGULAR = 0.5  # share of the power on a lattice from which no other is looked for


def coarse_share(linear: Tensor, valid: Tensor) -> float:
    """Share of the variance of log luminance in the texture's coarsest band, in [0, 1].

    Lower frequencies than that band are shading and left out.

    Args:
        linear: (3, H, W) picture of the plane, DETAIL texels across.
        valid: (H, W) bool, texels seen and not clipped.
    """
    seen = valid.numpy().astype(np.float32)
    if not seen.any():
        return 0.0
    log = np.log(np.maximum(linear.mean(0).numpy(), _FAINTEST))
    middle = float(np.median(log[seen > 0.0]))
    finer = (log - middle).clip(-MOST_RESIDUAL, MOST_RESIDUAL)
    variances = []
    for scale in (2.0**octave for octave in range(_OCTAVES)):
        # The last blur removed all detail finer than half this scale: from 2 texels on, half as
        # many samples suffice.
        if scale > 2.0:
            finer, seen = _halved(finer), _halved(seen)
        deviation = min(scale, 2.0)
        weight = np.maximum(_blur(seen, deviation), 1e-3)
        blurred = _blur(finer * seen, deviation) / weight
        variances.append(float(np.average(np.square(finer - blurred), weights=seen)))
        finer = blurred
    whole = sum(variances)
    return variances[-1] / whole if whole > 0.0 else 0.0


def _blur(picture: NDArray[np.float32], deviation: float) -> NDArray[np.float32]:
    # OpenCV's default border excludes the outermost texel, a large share of a small picture.
    blurred = cv2.GaussianBlur(picture, (0, 0), deviation, borderType=cv2.BORDER_REFLECT)
    return np.asarray(blurred, np.float32)


def _halved(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """Box-filter to half the size."""
    size = tuple(max(1, side // 2) for side in picture.shape[::-1])
    return area_averaged(picture, size)


def network_input(plane: Plane, waves: tuple[Wave, ...] = ()) -> Plane:
    """The plane at most DETAIL texels across; half of that if its texture is coarse and aperiodic.

    Waves of any period are inputs of the network, so periodic textures need no coarser grid.
    """
    columns = plane.size[0]
    usual = plane.shrunk(DETAIL) if columns > DETAIL else plane
    if columns < DETAIL or waves or coarse_share(usual.linear, usual.valid) <= _MOST_COARSE:
        return usual
    return plane.shrunk(DETAIL // 2)


def lattice_of(plane: Plane) -> tuple[Wave, ...]:
    """Frequency vectors of a plane's lattice, cycles per texel; of the halved plane if it has one.

    Halved, a plane shows what is too long for find_lattice, such as checks of 90 texels.
    """
    lattice, half = find_lattice(plane.encoded(), plane.valid), plane
    while lattice.share < _MOST_REGULAR and half.size[0] >= DETAIL:
        half = half.shrunk(half.size[0] // 2)
        coarse = find_lattice(half.encoded(), half.valid)
        if coarse.share >= _MOST_REGULAR:
            shorter = half.size[0] / plane.size[0]
            return tuple(Wave(shorter * wave.fx, shorter * wave.fy) for wave in coarse.waves)
    return lattice.waves


@dataclass(frozen=True)
class Rectified:
    """A photograph rectified to the plane of its sample, and its lattice."""

    photo: Photo
    """The photograph, its tone curve undone; of several, the first, less ambient light."""
    coarse: CoarseFit
    """Coarse fit of the photograph; of several, with the registered camera."""
    whole: Plane
    """The plane at the resolution of the exemplar."""
    waves: tuple[Wave, ...]
    """Frequency vectors of its lattice, cycles per texel of `whole`; empty without one."""
    network_input: Plane
    """The plane at the resolution that the network takes."""

    @staticmethod
    def of(photo: Photo, coarse: CoarseFit, detail: int) -> Rectified:
        """Rectify a photograph to a grid `detail` texels across, and find its lattice."""
        plane = read_plane(photo, coarse.setup, detail)
        whole, waves = fill_masked(plane, coarse), lattice_of(plane)
        return Rectified(photo, coarse, whole, waves, network_input(whole, waves))

    @property
    def input_waves(self) -> tuple[Wave, ...]:
        """Frequency vectors of the lattice, cycles per texel of `network_input`."""
        longer = self.whole.size[0] / self.network_input.size[0]
        return tuple(Wave(longer * wave.fx, longer * wave.fy) for wave in self.waves)

    def at_input_resolution(self) -> Rectified:
        """The same photograph with an exemplar at the network's resolution."""
        return replace(self, whole=self.network_input, waves=self.input_waves)


@torch.no_grad()
def fill_masked(plane: Plane, uniform: Uniform) -> Plane:
    """Fill masked texels by mirrored ones, times the ratio of the uniform material's radiance.

    With another place's shading they would bias networks and filters whose support includes them.

    Args:
        plane: the photograph; returned unchanged without masked texels.
    """
    if plane.left_out is None:
        return plane
    width, height = plane.size
    points = points_of((height, width))
    size = tuple(max(2, -(-side // SUBSAMPLING)) for side in (height, width))
    light = FlashLight.of(uniform.setup, resized(points, size))
    flat = resized(uniform_radiance(uniform, light)[0], (height, width)).clamp_min(1e-6)
    rows, columns = (torch.from_numpy(at) for at in mirrored(plane.left_out.numpy()))
    shown = plane.linear[:, rows, columns] * (flat / flat[:, rows, columns])
    return replace(plane, linear=torch.where(plane.left_out, shown, plane.linear))
