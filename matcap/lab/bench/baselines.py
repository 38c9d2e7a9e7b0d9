"""What a capture must beat: the photograph as albedo, and per-texel optimisation.

Both are given the true camera and flash, which a capture has to find out.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.errors import UsageError
from matcap.flash.geometry import FlashSetup, plane_points
from matcap.flash.rectify import rectify
from matcap.flash.render import render_flash, render_rectified
from matcap.photo.photo import Photo
from matcap.statistics.compare import Weights, describe, distance
from matcap.statistics.encoding import fit_encoding
from matcap.statistics.filterbank import FilterBank, FilterBankConfig

_SPECULAR, _ROUGHNESS = 0.04, 0.5
# How fast the six maps move, albedo first: all alike, every spot would become a steep or shiny one.
_PACE = (1.0, 1.0, 1.0, 0.25, 0.25, 0.25)


@dataclass(frozen=True)
class Fixed:
    """Maps that are all there is: asked for less, the middle is given.

    Attributes:
        whole: the maps.
        setup: camera and flash they go with.
    """

    whole: MapSet
    setup: FlashSetup

    @property
    def texel_size(self) -> float:
        """A texel's side in plane units."""
        return self.whole.texel_size

    def maps(self, width: int, height: int, *, seed: int = 0) -> MapSet:
        """The middle of the maps; `seed` cannot make more of them."""
        have_width, have_height = self.whole.size
        if width > have_width or height > have_height:
            raise UsageError(
                f"the photograph gives {have_width} x {have_height} texels of map, "
                f"{width} x {height} were asked for"
            )
        x, y = (have_width - width) // 2, (have_height - height) // 2
        return self.whole.crop(x, y, width, height)


@dataclass(frozen=True)
class Tiled:
    """Periodic maps, repeated; the seed says where the repetition starts.

    Attributes:
        tile: one period.
        setup: camera and flash they go with.
    """

    tile: MapSet
    setup: FlashSetup

    @property
    def texel_size(self) -> float:
        """A texel's side in plane units."""
        return self.tile.texel_size

    def maps(self, width: int, height: int, *, seed: int = 0) -> MapSet:
        """A rectangle of the repetition."""
        period_x, period_y = self.tile.size
        generator = torch.Generator().manual_seed(seed)
        columns = (torch.arange(width) + _below(period_x, generator)) % period_x
        rows = (torch.arange(height) + _below(period_y, generator)) % period_y
        repeated = self.tile.stacked()[..., rows[:, None], columns]
        return MapSet.from_stacked(repeated, self.texel_size)


def photo_as_albedo(photo: Photo, setup: FlashSetup, detail: int) -> Fixed:
    """The photograph itself as diffuse albedo; constant F0 and roughness; flat.

    The flash's intensity is the one that gives the photograph's mean back.

    Args:
        photo: the photograph.
        setup: true geometry.
        detail: texels along the long side.
    """
    linear, _ = rectify(photo, setup, detail)
    diffuse = linear.clamp(0.0, 1.0)
    flat = torch.zeros_like(diffuse[:1])
    maps = MapSet(diffuse, flat + _SPECULAR, flat + _ROUGHNESS, flat, texel_size=2.0 / detail)
    again = render_rectified(maps, setup.with_intensity((1.0, 1.0, 1.0))).clamp_min(0.0)
    gain = float(linear.mean() / again.mean())
    return Fixed(maps, setup.with_intensity((gain, gain, gain)))


@dataclass(frozen=True)
class PerTexelSettings:
    """How long and with what per-texel maps are optimised.

    Attributes:
        tile: texels of the periodic maps, a side, and of the windows they are compared with.
        steps: of Adam, at most.
        seconds: at most.
        rate: Adam's learning rate.
        seed: of start and windows.
    """

    tile: int = 192
    steps: int = 600
    seconds: float = 60.0
    rate: float = 0.05
    seed: int = 0


def per_texel(
    photo: Photo, setup: FlashSetup, detail: int, settings: PerTexelSettings | None = None
) -> Tiled:
    """One periodic patch of maps whose flash pictures match the photograph's texture everywhere.

    After Aittala, Aila, Lehtinen (2016), "Reflectance Modeling by Neural Texture Synthesis": maps
    are free texel by texel, and what their rendering at many places of the photograph must match
    is their texture statistics. Simpler here: the statistics are capture's own, with random filters
    for a trained network, and the maps have no prior.

    Args:
        photo: the photograph.
        setup: true camera and flash.
        detail: texels along the long side.
        settings: how long.
    """
    settings = settings or PerTexelSettings()
    linear, valid = rectify(photo, setup, detail)
    generator = torch.Generator().manual_seed(settings.seed)
    bank = FilterBank(FilterBankConfig(filters=16, levels=4, seed=4242))
    encoding = fit_encoding(linear, valid)
    start = _start_maps(linear[:, valid].mean(1), setup)
    free = 0.1 * torch.randn(6, settings.tile, settings.tile, generator=generator)
    free.requires_grad_()
    optimiser = torch.optim.Adam([free], lr=settings.rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.steps)
    extent = (detail, linear.shape[1])
    began = time.monotonic()
    for _ in range(settings.steps):
        if time.monotonic() - began > settings.seconds:
            break
        x, y = (_below(side - settings.tile + 1, generator) for side in extent)
        shift = (_below(settings.tile, generator), _below(settings.tile, generator))
        with torch.no_grad():
            window = linear[None, :, y : y + settings.tile, x : x + settings.tile]
            target = describe(window, encoding, bank)
        points = plane_points(x, y, settings.tile, settings.tile, extent, dtype=torch.float32)
        rolled = _maps(start, free, 2.0 / detail).map(_rolling(shift))
        rendered = render_flash(rolled, setup, points)[None]
        error = distance(describe(rendered, encoding, bank), target, Weights()).mean()
        optimiser.zero_grad()
        error.backward()
        optimiser.step()
        schedule.step()
    tile = _maps(start, free.detach(), 2.0 / detail)
    return Tiled(tile, setup)


def _start_maps(mean: Tensor, setup: FlashSetup) -> Tensor:
    """(6, 1, 1) where the maps start, before their bounds: the photograph's mean, flat."""
    intensity = torch.tensor(setup.intensity)
    albedo = (mean * torch.pi * setup.distance**2 / intensity).clamp(0.02, 0.9)
    bounded = torch.cat([albedo, torch.tensor([_SPECULAR, _ROUGHNESS])]).logit()
    return torch.cat([bounded, torch.zeros(1)])[:, None, None]


def _maps(start: Tensor, free: Tensor, texel_size: float) -> MapSet:
    """Maps at start + pace * free, in their bounds."""
    moved = start + torch.tensor(_PACE)[:, None, None] * free
    bounded = torch.sigmoid(moved[:5])
    return MapSet(
        diffuse=bounded[:3],
        specular=bounded[3:4],
        roughness=bounded[4:5],
        height=texel_size * moved[5:6],
        texel_size=texel_size,
        periodic=True,
    )


def _rolling(shift: tuple[int, int]) -> Callable[[Tensor], Tensor]:
    return lambda m: torch.roll(m, shift, dims=(-1, -2))


def _below(count: int, generator: torch.Generator) -> int:
    return int(torch.randint(count, (), generator=generator))
