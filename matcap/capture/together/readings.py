"""Network predictions of each photograph, fused in the first one's frame.

Each is read on a plane of its own, upright before its own camera, as one alone would be, under the
light that alignment found. Brought over the first, what they say of a texel is joined by what each
expects to be off by, in any order. Half of what readings are off by is the network's habit and
shared by all: more readings make that no smaller.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.together.align import Aligned
from matcap.capture.together.hue import achromatic
from matcap.capture.together.surface import surface_of
from matcap.capture.together.texels import (
    ALBEDO,
    F0,
    ROUGH,
    SLOPES,
    Estimate,
    maps_of,
    numbers_of,
)
from matcap.capture.together.views import SetLight, ViewPlace
from matcap.flash.coarse import CoarseFit
from matcap.flash.extent import OWN, Extent
from matcap.flash.geometry import FlashSetup
from matcap.flash.plane import Plane, read_plane
from matcap.flash.registration.camera import Doubles, PosedCamera

UNREAD = 4.0  # log of what a reading is off by where its photograph does not show the piece
_NOTHING = 1e-8  # that a reading weighs at its border: its doubt is beyond UNREAD then

Floats = NDArray[np.float32]
ReadAlone = Callable[[Plane, CoarseFit], Estimate]  # of a photograph alone, on its own plane


@dataclass(frozen=True)
class ReadingSettings:
    """How readings are joined; docs/notes/several.md."""

    across: int = 384
    """Texels that all but the first are read on: what is finer is the first one's."""
    steepest: float = 35.0
    """Degrees of tilt beyond which a photograph is not read: no training has seen it."""
    shared: float = 0.5
    """Of what readings are off by, in squares: the network's habit, which more of them do not
    lessen."""
    fades: float = 0.12
    """Of a reading's width: as wide a border counts less and less, to nothing."""


READINGS = ReadingSettings()


@dataclass(frozen=True)
class OwnPlane:
    """The plane's frame that belongs to a camera, in that of the first."""

    setup: FlashSetup
    """Of the camera and its flash, in its own frame."""
    origin: Doubles
    """(2,) of it."""
    scale: float
    """Its unit."""
    roll: float
    """Radians that its x lies to the left of the first's."""

    @staticmethod
    def of(camera: PosedCamera, light: SetLight, number: int) -> OwnPlane:
        """Of a camera, under the light of a photograph's number."""
        distance = camera.place[2] / camera.turn[2, 2]
        origin = (camera.place - distance * camera.turn[2])[:2]
        scale = float(distance / camera.lens.focal)
        roll = math.atan2(-camera.turn[1, 0], camera.turn[1, 1])
        c, s = math.cos(roll), math.sin(roll)
        turn = camera.turn @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        tilt = (math.atan2(-turn[1, 2], turn[1, 1]), math.atan2(-turn[2, 0], turn[0, 0]))
        x, y = (light.offset / scale).tolist()
        lost, more = light.vignetting.tolist()
        strength = light.intensity * light.gain[number].exp() / scale**2
        red, green, blue = strength.tolist()
        setup = FlashSetup(
            math.degrees(2.0 * math.atan(1.0 / camera.lens.focal)),
            (x, y, 0.0),
            tilt,
            (red, green, blue),
            lost,
            more,
        )
        return OwnPlane(setup, origin, scale, roll)

    def here(self, points: Doubles) -> Doubles:
        """(2, ...) in this frame of points (3, ...) of the first's plane."""
        c, s = math.cos(self.roll), math.sin(self.roll)
        offset = points[:2] - self.origin.reshape(2, *(1,) * (points.ndim - 1))
        return np.asarray(np.tensordot(np.array([[c, s], [-s, c]]), offset, 1)) / self.scale


@dataclass(frozen=True)
class ReadView:
    """What was read from a photograph, on the first one's texels."""

    numbers: Tensor
    """(NUMBERS, H, W)."""
    doubt: Tensor
    """(4, H, W) log of what it is expected to be off by (solve.py)."""
    extent: Extent = OWN
    """Of those texels."""
    hue: Tensor | None = None
    """(3, H, W) metal's, that was taken off (hue.py), where it was read of any."""


def read_views(
    alignment: Aligned,
    first: Estimate,
    coarse: CoarseFit,
    read: ReadAlone,
    on_progress: Callable[[float], None],
) -> list[ReadView | None]:
    """What every photograph is read as, one at a time.

    Args:
        alignment: where they lie, and their light.
        first: read from the first, in the estimated frame.
        coarse: of the first, whose mean material is all of theirs.
        read: one alone.
        on_progress: called with the share that is done.

    Returns:
        For each photograph, None where it was not read: of the room's light, or too steep.
    """
    extent = alignment.extent
    width, height = first.maps.size
    own_across = min(READINGS.across, round(extent.unit(width)))
    across = extent.across(own_across)
    down = max(8, round(height * across / width))
    small = first.resized((down, across), extent)
    readings: list[ReadView | None] = [ReadView(numbers_of(small.maps), small.log_error, extent)]
    for number, view in enumerate(alignment.views[1:], 1):
        readings.append(None)
        if view.flash and math.degrees(view.camera.tilt) < READINGS.steepest:
            own = OwnPlane.of(view.camera, alignment.light, number)
            plane = read_plane(view.photo, own.setup, own_across)
            theirs = read(plane, replace(coarse, setup=own.setup))
            place = alignment.places[number]
            readings[-1] = brought_over(theirs, own, view.camera, place, (across, down))
        on_progress(number / (len(alignment.views) - 1))
    return readings


def brought_over(
    read: Estimate,
    own: OwnPlane,
    camera: PosedCamera,
    place: ViewPlace,
    size: tuple[int, int],
) -> ReadView:
    """A reading of a photograph's own plane on a grid of (across, down) texels of the first's."""
    width, height = read.maps.size
    points = own.here(camera.on_plane(camera.sees(place.points(*size))))
    x = ((points[0] + 1.0) * width / 2.0 - 0.5).astype(np.float32)
    y = ((height - points[1] * width) / 2.0 - 0.5).astype(np.float32)

    def there(channel: Tensor, how: int = cv2.INTER_CUBIC) -> Tensor:
        resampled = cv2.remap(channel.numpy(), x, y, how, borderMode=cv2.BORDER_REFLECT_101)
        return torch.from_numpy(resampled)

    maps, hue = achromatic(read.maps)
    logs = torch.cat([maps.diffuse.clamp_min(1e-3).log(), maps.specular.clamp_min(5e-3).log()])
    stacked = torch.stack([there(c) for c in torch.cat([logs, maps.roughness, maps.height])])
    over = MapSet(
        stacked[:3].exp(),
        stacked[3:4].exp(),
        stacked[4:5],
        own.scale * stacked[5:],
        place.extent.texel(size[0]),
    )
    unsure = torch.stack([there(channel, cv2.INTER_LINEAR) for channel in read.log_error])
    unsure = (unsure + torch.from_numpy(_fading(x, y, (width, height)))).clamp_max(UNREAD)
    tint = None if hue is None else torch.stack([there(c, cv2.INTER_LINEAR) for c in hue])
    return ReadView(numbers_of(over), unsure, place.extent, tint)


def _fading(x: Floats, y: Floats, size: tuple[int, int]) -> Floats:
    """Log by which doubt grows towards a reading's border: maps would show where one begins."""
    width, height = size
    within = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y))
    share = (within / (READINGS.fades * width)).clip(0.0, 1.0)
    weight = share**2 * (3.0 - 2.0 * share)
    return np.asarray(-0.5 * np.log(np.maximum(weight, _NOTHING)), np.float32)


def joined(readings: Sequence[ReadView | None]) -> Estimate:
    """What all readings say, in any order.

    Args:
        readings: at least one that is not None.
    """
    every = [read for read in readings if read is not None]
    weights = torch.stack([(-2.0 * read.doubt.clamp(-8.0, 8.0)).exp() for read in every])
    whole = weights.sum(0)
    numbers = torch.zeros_like(every[0].numbers)
    for part, kind in ((ALBEDO, 0), (F0, 1), (ROUGH, 2), (SLOPES, 3)):
        for read, weight in zip(every, weights, strict=True):
            numbers[part] += weight[kind] / whole[kind] * read.numbers[part]
    # Where all err alike they are off by as much as the best of them.
    alike = weights.amax(0).reciprocal()
    doubt = 0.5 * (READINGS.shared * alike + (1.0 - READINGS.shared) / whole).log()
    slope_precision = (-2.0 * doubt[3]).exp()
    texel_size = every[0].extent.texel(numbers.shape[-1])
    precision = torch.stack([slope_precision, slope_precision, torch.zeros_like(slope_precision)])
    height = surface_of(numbers[SLOPES], texel_size, precision)
    return Estimate(maps_of(numbers, height, texel_size), doubt)


def with_others(first: Estimate, readings: Sequence[ReadView | None]) -> Estimate:
    """What was read from the first photograph as all readings together say.

    What is finer than the grid of the readings stays the first one's.
    """
    alone, together = joined(readings[:1]), joined(readings)
    maps, own = first.maps, readings[0]

    def wide(change: Tensor) -> Tensor:
        return F.interpolate(change[None], size=maps.size[::-1], mode="bilinear")[0]

    log_error = first.log_error + wide(together.log_error - alone.log_error)
    if own is not None and own.extent != OWN:
        # Beyond the first one there is no height of it, and only slopes can be added to.
        numbers = numbers_of(maps) + wide(numbers_of(together.maps) - own.numbers)
        raised = surface_of(numbers[SLOPES], maps.texel_size)
    else:
        numbers = numbers_of(maps) + wide(numbers_of(together.maps) - numbers_of(alone.maps))
        raised = maps.height + wide(together.maps.height - alone.maps.height)
    return Estimate(maps_of(numbers, raised, maps.texel_size), log_error)


def fewer(readings: Sequence[ReadView | None], size: tuple[int, int]) -> list[ReadView | None]:
    """Readings on fewer texels, (rows, columns)."""

    def small(values: Tensor) -> Tensor:
        return F.interpolate(values[None], size=size, mode="area")[0]

    return [one and ReadView(small(one.numbers), small(one.doubt), one.extent) for one in readings]
