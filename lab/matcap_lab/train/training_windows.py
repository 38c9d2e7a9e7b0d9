"""Training windows: pieces of photographs, lit and seen as where they were cut, and their turns.

A flip or a quarter turn is applied to pixels, plane points, vignetting, camera, flash and waves
alike, so the geometry stays consistent. Colour channels are permuted and scaled a little (white
balance), together with the base.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.flash.geometry import camera_in_plane, plane_points
from matcap.flash.light import vignette
from matcap.flash.plane import read_plane
from matcap.flash.render import shade
from matcap.space.picture import picture
from matcap.space.prior.base import Base, base_of
from matcap.space.prior.encoder_input import numbers
from matcap.statistics.encoding import Encoding
from matcap.statistics.lattice import Wave
from matcap_lab.train.pack import WAVE_DETAIL, Entry

_MOST_GAIN = 1.15  # of one colour over another
_LEAST_SEEN = 0.5  # of a window that must be valid


@dataclass(frozen=True)
class Turn:
    """One of the square's eight symmetries: mirrored along x or not, then quarter turns."""

    mirrored: bool = False
    quarters: int = 0

    def image(self, image: Tensor) -> Tensor:
        """(..., H, W) moved."""
        image = image.flip(-1) if self.mirrored else image
        return torch.rot90(image, self.quarters, (-2, -1))

    def vector(self, vector: Tensor) -> Tensor:
        """(N, ...) vectors whose first two parts are x (right) and y (up), moved alike."""
        x, y = vector[0], vector[1]
        x = -x if self.mirrored else x
        for _ in range(self.quarters % 4):
            x, y = -y, x
        return torch.cat([torch.stack([x, y]), vector[2:]])

    def wave(self, wave: Wave) -> Wave:
        """A wave, whose y is counted downwards, moved alike."""
        x, y = self.vector(torch.tensor([wave.fx, -wave.fy], dtype=torch.float64)).tolist()
        return Wave(x, -y)


@dataclass(frozen=True)
class PreparedPhotograph:
    """A photograph ready to be cut: everything that does not change from step to step."""

    linear: Tensor
    """(3, H, W) float16, rectified at WAVE_DETAIL texels across."""
    valid: Tensor
    """(H, W) bool."""
    picture: Tensor
    """(5, h, w) what the encoder sees."""
    encoding: Encoding
    """Encoding of the photograph."""
    entry: Entry
    """Its entry in the pack."""
    truth: MapSet | None = None
    """Maps of the same material where it was simulated, or None."""


def prepare(entry: Entry, encoder_width: int, truth: MapSet | None = None) -> PreparedPhotograph:
    """Decode and rectify a photograph of the pack; keep the maps of its material, if known."""
    photo = entry.photo()
    plane = read_plane(photo, entry.coarse.setup, WAVE_DETAIL)
    shown = picture(photo.pixels, encoder_width)
    return PreparedPhotograph(
        plane.linear.half(), plane.valid, shown, plane.encoding, entry,
        None if truth is None else truth.map(Tensor.float),
    )  # fmt: skip


@dataclass(frozen=True)
class TrainingSample:
    """One material of a batch."""

    picture: Tensor
    """(5, h, w) picture for the encoder."""
    numbers: Tensor
    """(NUMBERS,) for the encoder."""
    base: Base
    """Reflectance to which the decoder's outputs are relative."""
    waves: tuple[Wave, ...]
    """Frequencies of the material's lattice, in the windows' texels."""
    linear: Tensor
    """(K, 3, S, S) windows of the photograph."""
    points: Tensor
    """(K, 3, S, S) their plane points."""
    shading: Tensor
    """(K, 1, S, S) vignetting."""
    camera: Tensor
    light: Tensor
    intensity: Tensor
    """(3,) each, plane frame."""
    encoding: Encoding
    """Encoding of the photograph, its colours permuted like the windows'."""
    texel_size: float
    """A texel's side, plane units."""
    truth: MapSet | None = None
    """(1, C, S, S) maps of another piece of the same material, or None."""

    def to(self, device: torch.device | str) -> TrainingSample:
        """The same sample on a device."""
        tensors: dict[str, Any] = {
            name: value.to(device)
            for name, value in vars(self).items()
            if isinstance(value, Tensor)
        }
        return replace(
            self,
            base=Base(self.base.mean.to(device), self.base.deviation.to(device)),
            truth=None if self.truth is None else self.truth.map(lambda m: m.to(device)),
            **tensors,
        )

    def render(self, maps: MapSet) -> Tensor:
        """(K, 3, S, S) the maps lit and seen as in each of the windows."""
        shaded = shade(maps, self.points, self.camera, self.light, self.intensity)
        return shaded * self.shading


def cut(
    source: PreparedPhotograph,
    size: int,
    places: int,
    coarser: int,
    turn: Turn,
    rng: np.random.Generator,
    *,
    augment: bool = True,
) -> TrainingSample:
    """Cut windows of `size` texels, each `coarser` (1 or 2) of the source's, and turn them.

    With `augment` their colours are also permuted and scaled.
    """
    setup = source.entry.coarse.setup
    height, width = source.linear.shape[-2:]
    span = size * coarser
    crops, points, shading = [], [], []
    for _ in range(places):
        x, y = _place(source.valid, span, rng)
        crop = source.linear[:, y : y + span, x : x + span].float()
        crops.append(F.avg_pool2d(crop, coarser) if coarser > 1 else crop)
        place = plane_points(
            x // coarser, y // coarser, size, size, (width // coarser, height // coarser),
            dtype=torch.float32,
        )  # fmt: skip
        points.append(turn.image(turn.vector(place)))
        shading.append(turn.image(vignette(place, setup)))
    order, gain = torch.arange(3), torch.ones(3)
    if augment:
        order = torch.from_numpy(rng.permutation(3))
        gain = torch.from_numpy(rng.uniform(1.0, _MOST_GAIN, 3)).float()
    hue = torch.log(gain) - torch.log(gain).mean()
    base = base_of(source.entry.coarse, source.entry.contrast)
    inputs = numbers(source.entry.coarse, source.entry.contrast, WAVE_DETAIL // coarser)
    camera, light = camera_in_plane(setup)
    shown = torch.cat(
        [
            source.picture[:3][order] + hue[:, None, None],
            turn.vector(source.picture[3:]),
        ]
    )
    colours = torch.cat([order, torch.arange(3, 6)])
    mean = base.mean[colours].clone()
    mean[:3] += torch.log(gain)
    inputs[:3], inputs[5:8] = inputs[:3][order] + torch.log(gain), inputs[5:8][order]
    inputs[9:11], inputs[11:13] = _turned_numbers(inputs, turn)
    return TrainingSample(
        picture=turn.image(shown),
        numbers=inputs,
        base=Base(mean, base.deviation[colours]),
        waves=tuple(turn.wave(Wave(w.fx * coarser, w.fy * coarser)) for w in source.entry.waves),
        linear=turn.image(torch.stack(crops))[:, order] * gain[:, None, None],
        points=torch.stack(points),
        shading=torch.stack(shading),
        camera=turn.vector(camera).float(),
        light=turn.vector(light).float(),
        intensity=torch.tensor(setup.intensity),
        encoding=Encoding(source.encoding.median, source.encoding.matrix[:, order]),
        texel_size=2.0 * coarser / width,
        truth=_true_window(source.truth, size, coarser, turn, rng, order, gain),
    )


def _true_window(
    truth: MapSet | None,
    size: int,
    coarser: int,
    turn: Turn,
    rng: np.random.Generator,
    order: Tensor,
    gain: Tensor,
) -> MapSet | None:
    """A window of true maps, with the turn and colours of the photograph's windows."""
    if truth is None:
        return None
    span = size * coarser
    x, y = (int(rng.integers(0, side - span + 1)) for side in truth.size)
    maps = truth.stacked()[None, :, y : y + span, x : x + span]
    maps = turn.image(F.avg_pool2d(maps, coarser) if coarser > 1 else maps)
    diffuse = (maps[:, order] * gain[:, None, None]).clamp_max(1.0)
    stacked = torch.cat([diffuse, maps[:, 3:]], dim=1)
    return MapSet.from_stacked(stacked, truth.texel_size * coarser)


def _turned_numbers(inputs: Tensor, turn: Turn) -> tuple[Tensor, Tensor]:
    """Offset and tilt among the encoder's numbers, moved.

    Tilts are rotations: about x by tilt_x, about y by tilt_y. To first order the plane's normal
    leans by (tilt_y, -tilt_x), and that vector moves like any other.
    """
    leaning = turn.vector(torch.stack([inputs[12], -inputs[11]]))
    return turn.vector(inputs[9:11]), torch.stack([-leaning[1], leaning[0]])


def _place(valid: Tensor, span: int, rng: np.random.Generator) -> tuple[int, int]:
    """Random even position of a window that is mostly valid, or the last of ten tries."""
    height, width = valid.shape
    x = y = 0
    for _ in range(10):
        x = 2 * int(rng.integers(0, (width - span) // 2 + 1))
        y = 2 * int(rng.integers(0, (height - span) // 2 + 1))
        if float(valid[y : y + span : 4, x : x + span : 4].float().mean()) >= _LEAST_SEEN:
            break
    return x, y
