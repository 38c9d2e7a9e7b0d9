"""Style distances of textures, by statistics that no capture optimises.

1. *Portilla-Simoncelli* [portilla2000] statistics of the grey picture, by plenoptic (extra
   `bench`), and mean and covariance of its colours. The distance is the mean over
   groups g of statistics of

       |a_g - b_g|_1 / ((|a_g|_1 + |b_g|_1) / 2 + n_g t_g),

   with n_g values to a group. The denominator makes a group's term a relative error of at most 2,
   so that no group dominates; t_g is a threshold of visibility, which keeps small values from being
   amplified: 0.05 for correlations, 0.2 for skew and kurtosis, 0.005 (about one 8-bit code value)
   for means and deviations, its square for variances.
2. *Random filters* of other sizes (7, 11, 13) and another seed than capture's, on a pyramid of four
   levels, rectified: the mean over levels and over {Gram matrices, means} of the same relative L1,
   with t = 0. The raw colours are among the means.
3. *Patches*: sliced Wasserstein distance [rabin2011] of patches [elnekave2022] of 3, 7 and 15
   texels a side at three scales, projected on random directions and sorted. Sensitive to colours,
   edges and grain, hardly to structures longer than a patch.

All are 0 for equal pictures, and symmetric.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.errors import MatcapError
from matcap.files.rec709 import LUMINANCE
from matcap.statistics.filterbank import FilterBank, FilterBankConfig, pyramid
from matcap.statistics.gram import gram

_CODE_VALUE = 0.005
_CORRELATION = 0.05
_MOMENT = 0.2

# Groups of plenoptic's statistics and each one's threshold of visibility t_g.
_GROUPS: Mapping[str, float] = {
    "auto_correlation_magnitude": _CORRELATION,
    "auto_correlation_reconstructed": _CORRELATION,
    "cross_orientation_correlation_magnitude": _CORRELATION,
    "cross_scale_correlation_magnitude": _CORRELATION,
    "cross_scale_correlation_real": _CORRELATION,
    "skew_reconstructed": _MOMENT,
    "kurtosis_reconstructed": _MOMENT,
    "std_reconstructed": _CODE_VALUE,
    "magnitude_std": _CODE_VALUE,
    "var_highpass_residual": _CODE_VALUE**2,
}
# Of pixel_statistics: mean, variance, skew, kurtosis; its extremes are single pixels.
_PIXEL = {"mean": _CODE_VALUE, "variance": _CODE_VALUE**2, "skew": _MOMENT, "kurtosis": _MOMENT}


@dataclass(frozen=True)
class Group:
    """Statistics (B, N) that enter the distance as one term; their threshold of visibility t_g."""

    values: Tensor
    unseen: float


StyleStatistics = dict[str, Group]


class Style(Protocol):
    """Texture statistics: sRGB pictures (B, 3, H, W) in [0, 1] to groups."""

    def __call__(self, pictures: Tensor) -> StyleStatistics:
        """Style statistics of pictures."""
        ...


def difference(first: StyleStatistics, second: StyleStatistics) -> Tensor:
    """(B,) distance between pictures of the same lights, the mean over groups."""
    return torch.stack([_relative(first[name], second[name]) for name in first]).mean(0)


class PortillaSimoncelli:
    """Portilla-Simoncelli statistics of grey, mean and covariance of colours."""

    def __init__(self, size: tuple[int, int]) -> None:
        """Prepare for pictures of (width, height).

        Raises:
            MatcapError: plenoptic is not installed.
        """
        try:
            from plenoptic.models import PortillaSimoncelli as Model
        except ImportError as error:
            raise MatcapError(
                "Portilla-Simoncelli statistics need the package plenoptic",
                remedy="install it with: pip install './lab[bench]'",
            ) from error
        self._model: Any = Model(
            (size[1], size[0]), n_scales=4, n_orientations=4, spatial_corr_width=9
        )

    @torch.no_grad()
    def __call__(self, pictures: Tensor) -> StyleStatistics:
        """Describe (B, 3, H, W)."""
        luma = torch.tensor(LUMINANCE).to(pictures)[:, None, None]
        grey = (pictures * luma).sum(1, keepdim=True)
        statistics = self._model.convert_to_dict(self._model(grey))
        groups = {
            name: Group(_finite(statistics[name]), unseen) for name, unseen in _GROUPS.items()
        }
        pixel = _finite(statistics["pixel_statistics"])
        for column, (name, unseen) in enumerate(_PIXEL.items()):
            groups[f"pixel {name}"] = Group(pixel[:, column : column + 1], unseen)
        colours = pictures.flatten(2)
        centred = colours - colours.mean(2, keepdim=True)
        covariance = centred @ centred.transpose(1, 2) / colours.shape[2]
        groups["colour mean"] = Group(colours.mean(2), _CODE_VALUE)
        groups["colour covariance"] = Group(covariance.flatten(1), _CODE_VALUE**2)
        return groups


class RandomFilters:
    """Gram matrices and means of random filters other than capture's."""

    def __init__(self) -> None:
        self._bank = FilterBank(FilterBankConfig(sizes=(7, 11, 13), filters=20, levels=4, seed=777))

    @torch.no_grad()
    def __call__(self, pictures: Tensor) -> StyleStatistics:
        """Describe (B, 3, H, W)."""
        groups = {}
        for level, image in enumerate(pyramid(pictures, self._bank.config.levels)):
            features = self._bank.features(image.contiguous(memory_format=torch.channels_last))
            means = torch.cat([features.mean((2, 3)), image.mean((2, 3))], dim=1)
            groups[f"gram {level}"] = Group(gram(features)[:, :-1, :-1].flatten(1), 0.0)
            groups[f"means {level}"] = Group(means, 0.0)
        return groups

    @torch.no_grad()
    def features(self, pictures: Tensor) -> list[Tensor]:
        """Rectified responses (B, filters, h, w) at every pyramid level of (B, 3, H, W)."""
        return self._bank.maps(pictures, pyramid(pictures, self._bank.config.levels))


def _relative(first: Group, second: Group) -> Tensor:
    """(B,) relative L1 difference of a group."""
    difference = (first.values - second.values).abs().mean(1)
    size = (first.values.abs().mean(1) + second.values.abs().mean(1)) / 2.0
    return difference / (size + first.unseen).clamp_min(1e-12)


def _finite(statistics: Tensor) -> Tensor:
    """(B, N) without plenoptic's NaN, which mark entries redundant by symmetry."""
    flat = statistics.flatten(1)
    return flat[:, torch.isfinite(flat[0])]


SIDES = (3, 7, 15)  # texels of a patch
SCALES = 3  # each of half the size of the one before
_DIRECTIONS = 64  # a side and scale
_QUANTILES = 128  # along each
_SEED = 4242
_UNSEEN = 0.005  # about one 8-bit code value


class Patches:
    """Sorted projections of patches."""

    def __init__(self) -> None:
        """Draw directions, all of unit length."""
        generator = torch.Generator().manual_seed(_SEED)
        self._directions = []
        for side in SIDES:
            drawn = torch.randn(_DIRECTIONS, 3, side, side, generator=generator)
            self._directions.append(drawn / drawn.flatten(1).norm(dim=1)[:, None, None, None])

    @torch.no_grad()
    def __call__(self, pictures: Tensor) -> StyleStatistics:
        """Describe sRGB-encoded pictures (B, 3, H, W) in [0, 1].

        Raises:
            ValueError: pictures whose coarsest scale holds no patch.
        """
        if min(pictures.shape[-2:]) < max(SIDES) * 2 ** (SCALES - 1):
            raise ValueError(f"pictures of {tuple(pictures.shape)} are too small to be compared")
        shares = (torch.arange(_QUANTILES) + 0.5) / _QUANTILES
        groups = {}
        for scale in range(SCALES):
            picture = F.avg_pool2d(pictures, 2**scale)
            for side, directions in zip(SIDES, self._directions, strict=True):
                along = F.conv2d(picture, directions).flatten(2).sort(dim=2).values
                places = (shares * along.shape[2]).long()
                groups[f"scale {scale}, side {side}"] = Group(
                    along[..., places].flatten(1), _UNSEEN
                )
        return groups
