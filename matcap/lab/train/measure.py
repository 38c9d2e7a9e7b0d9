"""Held-out photographs, and errors of pictures of a material against them.

Pictures are compared in the middle of the photograph, under its own flash: style by random filters
that no capture optimises, colours by XYZ histograms, and diversity of the realisations.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.field.material import Material
from matcap.files.srgb import srgb_encode_tensor
from matcap.flash.geometry import FlashSetup, plane_points
from matcap.flash.plane import Plane, read_plane
from matcap.flash.render import render_flash
from matcap.lab.experiment.results import Value
from matcap.lab.measures.nsd import style_distance
from matcap.lab.measures.paper_metrics import diversity, xyz_difference
from matcap.lab.measures.style import RandomFilters
from matcap.lab.train.decoder_only import DecoderOnly, Unfolded
from matcap.lab.train.pack import Entry
from matcap.photo.photo import Photo
from matcap.space.decoder import Decoder
from matcap.space.prior.encoder_input import FEATURES
from matcap.space.tuned import TunedDecoder
from matcap.space.tuning.finetune import RATE_FROM_NOTHING, TuneSettings, finetune
from matcap.space.tuning.likeness import PhotographTarget
from matcap.space.tuning.windows import cut_windows
from matcap.statistics.filterbank import FilterBank

SIZE = 384  # texels a side of the pictures compared
DETAIL = 1024  # texels along the photograph's long side
_WINDOW = 160
_FIRST_SEED = 5


@dataclass(frozen=True)
class Photographed:
    """A photograph of the pack, decoded, rectified, and as the target of fine-tuning."""

    entry: Entry
    photo: Photo
    plane: Plane
    scene: PhotographTarget

    @property
    def middle(self) -> tuple[int, int]:
        """Left top texel (x, y) of the compared square."""
        width, height = self.plane.size
        return (width - SIZE) // 2, (height - SIZE) // 2

    @property
    def truth(self) -> Tensor:
        """(3, SIZE, SIZE) sRGB, the middle of the photograph."""
        x, y = self.middle
        return _shown(self.plane.linear[:, y : y + SIZE, x : x + SIZE])

    def lit(self, maps: MapSet, setup: FlashSetup | None = None) -> Tensor:
        """(3, SIZE, SIZE) sRGB of maps of SIZE texels a side in the middle, under the flash.

        `setup` is the coarse fit's by default.
        """
        points = plane_points(*self.middle, SIZE, SIZE, self.plane.size, dtype=torch.float32)
        with torch.inference_mode():
            return _shown(render_flash(maps, setup or self.scene.setup, points))


def _shown(linear: Tensor) -> Tensor:
    """Code values of a picture."""
    return srgb_encode_tensor(linear.clamp(0.0, 1.0))


def photographed(entry: Entry) -> Photographed:
    """Decode, rectify and describe a photograph of the pack."""
    photo, setup = entry.photo(), entry.coarse.setup
    plane, bank = read_plane(photo, setup, DETAIL), FilterBank(FEATURES)
    windows = cut_windows(plane, bank, _WINDOW)
    scene = PhotographTarget(windows, setup, plane.encoding, bank, entry.waves, plane.texel_size)
    return Photographed(entry, photo, plane, scene)


@dataclass(frozen=True)
class Made:
    """Result of a method on a photograph."""

    pictures: Tensor
    """(N, 3, SIZE, SIZE) sRGB realisations under the photograph's flash."""

    seconds: float
    """Run time of the method, without rendering."""

    method: str = ""


def compared(shown: Photographed, made: Made) -> Mapping[str, Value]:
    """Errors of a method's pictures against the photograph's, and their diversity."""
    first, truth, style = made.pictures[0], shown.truth, RandomFilters()
    return {
        "seconds": made.seconds,
        "style": style_distance(style, first[None], truth[None]),
        "XYZ": xyz_difference(first, truth),
        "diversity": diversity(made.pictures),
    }


def capture(
    tuned: Photographed,
    begin: Callable[[], tuple[Decoder, Tensor]],
    steps: int,
    realisations: int,
    rate: float = RATE_FROM_NOTHING,
) -> Made:
    """Fine-tune a decoder to a photograph, freeze it, and render some of its realisations."""
    started = time.perf_counter()
    decoder, code = begin()
    scene = tuned.scene
    outcome = finetune(
        decoder, code, scene, TuneSettings(steps=steps, learning_rate=rate), lambda *_: None
    )
    seconds = time.perf_counter() - started
    if outcome.interrupted:
        raise KeyboardInterrupt  # half a capture is no measurement
    decoder = outcome.decoder.eval().requires_grad_(False)
    frozen = (decoder, code, outcome.moments, scene.waves, scene.texel_size)
    material: Material | Unfolded
    if isinstance(decoder, DecoderOnly):
        material = Unfolded(*frozen)
    else:
        material = TunedDecoder(*frozen).material("", scene.setup)
    seeds = range(_FIRST_SEED, _FIRST_SEED + realisations)
    pictures = [tuned.lit(material.maps(SIZE, SIZE, seed=seed)) for seed in seeds]
    return Made(torch.stack(pictures), seconds)
