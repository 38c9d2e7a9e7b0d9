"""The evaluator: true samples of a material, relit as a camera sees them, to compare maps with.

Found maps are compared with other samples of the material than the photographed one, so that
nothing wins by pixel alignment, and under lights that they were not photographed by.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError
from matcap.flash.geometry import FlashSetup
from matcap.lab.measures.lights import BenchLight, BenchScene, bench_scene, relight_all
from matcap.lab.measures.nsd import NormalisedStyleDistance, SqueezeNetStyle
from matcap.lab.measures.squeezenet import WEIGHTS, SqueezeNet
from matcap.lab.measures.style import Style
from matcap.lab.simulate.photograph import PhoneCamera
from matcap.lab.simulate.specimen import Specimen

Intensity = tuple[float, float, float]  # of the flash that goes with maps


@dataclass(frozen=True)
class EvaluationSettings:
    """What pictures are compared."""

    detail: int = 512
    """Texels along the photograph's long side of the pictures compared."""

    size: int = 256
    """Texels a side of them, at least 128; of the middle of the plane."""

    camera: PhoneCamera = field(default_factory=PhoneCamera)
    """That takes the photograph, whose blur true samples have."""

    truths: int = 3
    """True samples, at least 2."""

    first: int | None = None
    """Seed of the first; by default the one after the photographed sample's."""

    finer: int = 4
    """True radiance is averaged over this many texels a side: it has detail below a pixel."""

    every: int = 2
    """Every so manieth of the bench's ten lights is used."""

    weights: Path = WEIGHTS
    """SqueezeNet's, by ncnn."""

    @property
    def squeezenet(self) -> SqueezeNetStyle:
        """The statistics of the normalised style distance."""
        return SqueezeNetStyle(SqueezeNet.load(self.weights))

    @property
    def width(self) -> float:
        """Of the square compared, in plane units."""
        return self.size * 2.0 / self.detail


class Evaluator:
    """True samples of a material, relit and described by one or more kinds of statistics."""

    def __init__(
        self,
        subject: Specimen,
        flash: FlashSetup,
        settings: EvaluationSettings,
        styles: Mapping[str, Style],
    ) -> None:
        """Relight true samples, none of them the photographed one.

        Args:
            subject: the material.
            flash: the true setup of the photograph.
            settings: sizes and lights.
            styles: what pictures are compared by, by name.
        """
        whole = bench_scene(flash)
        self.scene = BenchScene(whole.distance, whole.lights[:: settings.every])
        self.flash, self.settings, self.styles = flash, settings, dict(styles)
        finest = settings.detail * settings.finer
        texel, pixels = 2.0 / finest, settings.size * settings.finer
        first = subject.seed + 1 if settings.first is None else settings.first
        seeds = range(first, first + settings.truths)
        self.truths = [subject.pieces(seed)(pixels, pixels, texel) for seed in seeds]
        self._blur = settings.camera.blur * finest / settings.camera.width
        self._distances: dict[tuple[str, BenchScene], NormalisedStyleDistance] = {}

    @cached_property
    def pictures(self) -> list[Tensor]:
        """(L, 3, H, W) of each true sample under the evaluator's lights."""
        return self.relit_truths(self.scene)

    @property
    def own_scene(self) -> BenchScene:
        """The photograph's own light, alone."""
        x, y, z = self.flash.offset
        light = BenchLight((x, y, z + self.flash.distance), 1.0)
        return BenchScene(self.flash.distance, (light,))

    def relit_truths(self, scene: BenchScene) -> list[Tensor]:
        """(L, 3, H, W) of each true sample under a scene's lights."""
        size, intensity = (self.settings.size,) * 2, self.flash.intensity
        return [
            relight_all(maps, intensity, scene, size=size, blur=self._blur) for maps in self.truths
        ]

    def relit(self, maps: MapSet, intensity: Intensity, scene: BenchScene | None = None) -> Tensor:
        """(L, 3, H, W) of maps under the flash that goes with them, as truths are compared."""
        floats = maps.map(lambda m: m.detach().float())
        return relight_all(floats, intensity, scene or self.scene, size=(self.settings.size,) * 2)

    def nsd(
        self, pictures: Tensor, style: str | None = None, scene: BenchScene | None = None
    ) -> float:
        """Normalised style distance of pictures (L, 3, H, W) under a scene's lights.

        Args:
            pictures: as of `relit`.
            style: by which statistics; the first by default.
            scene: the evaluator's by default.
        """
        name, scene = style or next(iter(self.styles)), scene or self.scene
        if (name, scene) not in self._distances:
            truths = self.pictures if scene == self.scene else self.relit_truths(scene)
            self._distances[name, scene] = NormalisedStyleDistance(self.styles[name], truths)
        return self._distances[name, scene].of(pictures)

    def nsd_of(self, maps: MapSet, intensity: Intensity) -> float:
        """Normalised style distance of the middle of maps under the flash that goes with them."""
        return self.nsd(self.relit(self.middle(maps), intensity))

    def middle(self, maps: MapSet) -> MapSet:
        """The middle square that is compared.

        Raises:
            MatcapError: the maps are smaller.
        """
        side = self.side(maps.texel_size)
        width, height = maps.size
        if min(width, height) < side:
            raise MatcapError(
                f"the capture gives {width} x {height} texels, {side} x {side} are compared",
                remedy="compare smaller pictures",
            )
        return maps.crop((width - side) // 2, (height - side) // 2, side, side)

    def side(self, texel_size: float) -> int:
        """Texels of a size along the side of what is compared."""
        return round(self.settings.width / texel_size)
