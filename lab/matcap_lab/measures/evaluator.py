"""The evaluator: true samples of a material, relit as a camera sees them, to compare maps with.

Estimated maps are compared with samples of the material other than the photographed one, so that
pixel alignment gives no advantage, and under lights other than the photograph's.
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
from matcap_lab.measures.lights import BenchLight, BenchScene, bench_scene, relight_all
from matcap_lab.measures.nsd import SqueezeNetStyle, StyleRatio
from matcap_lab.measures.squeezenet import WEIGHTS, SqueezeNet
from matcap_lab.measures.style import Style
from matcap_lab.simulate.photograph import PhoneCamera
from matcap_lab.simulate.specimen import Specimen

Intensity = tuple[float, float, float]  # of the flash that goes with maps


@dataclass(frozen=True)
class EvaluationSettings:
    """Sizes, lights and true samples of the comparison."""

    detail: int = 512
    """Texels along the photograph's long side, at the resolution compared."""

    size: int = 256
    """Side of the compared central square, texels; at least 128."""

    camera: PhoneCamera = field(default_factory=PhoneCamera)
    """Camera of the photograph; its blur is applied to true samples."""

    truths: int = 3
    """Number of true samples, at least 2."""

    first: int | None = None
    """Seed of the first; by default the one after the photographed sample's."""

    finer: int = 4
    """True samples are shaded at this many texels a pixel, along each side, and averaged."""

    every: int = 2
    """Step through the bench's ten lights: 2 uses every second one."""

    weights: Path = WEIGHTS
    """SqueezeNet's weights file (ncnn)."""

    @property
    def squeezenet(self) -> SqueezeNetStyle:
        """The statistics of the normalised style distance."""
        return SqueezeNetStyle(SqueezeNet.load(self.weights))

    @property
    def width(self) -> float:
        """Side of the compared square, plane units."""
        return self.size * 2.0 / self.detail


class Evaluator:
    """True samples of a material, relit, with their texture statistics by one or more styles."""

    def __init__(
        self,
        subject: Specimen,
        flash: FlashSetup,
        settings: EvaluationSettings,
        styles: Mapping[str, Style],
    ) -> None:
        """Relight true samples, none of them the photographed one.

        `flash` is the true setup of the photograph; styles are texture statistics by name.
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
        self._distances: dict[tuple[str, BenchScene], StyleRatio] = {}

    @cached_property
    def pictures(self) -> list[Tensor]:
        """(L, 3, H, W) pictures of each true sample under the evaluator's lights."""
        return self.relit_truths(self.scene)

    @property
    def own_scene(self) -> BenchScene:
        """Scene lit by the photograph's own flash alone."""
        x, y, z = self.flash.offset
        light = BenchLight((x, y, z + self.flash.distance), 1.0)
        return BenchScene(self.flash.distance, (light,))

    def relit_truths(self, scene: BenchScene) -> list[Tensor]:
        """(L, 3, H, W) pictures of each true sample under a scene's lights."""
        size, intensity = (self.settings.size,) * 2, self.flash.intensity
        return [
            relight_all(maps, intensity, scene, size=size, blur=self._blur) for maps in self.truths
        ]

    def relit(self, maps: MapSet, intensity: Intensity, scene: BenchScene | None = None) -> Tensor:
        """(L, 3, H, W) pictures of maps; `intensity` is the flash's, estimated with them."""
        floats = maps.map(lambda m: m.detach().float())
        return relight_all(floats, intensity, scene or self.scene, size=(self.settings.size,) * 2)

    def style_ratio(
        self, pictures: Tensor, style: str | None = None, scene: BenchScene | None = None
    ) -> float:
        """Style distance of pictures (L, 3, H, W) relit in a scene, over that of true samples.

        Args:
            pictures: from `relit`.
            style: name of the statistics; the first by default.
            scene: camera and lights; the evaluator's by default.
        """
        name, scene = style or next(iter(self.styles)), scene or self.scene
        if (name, scene) not in self._distances:
            truths = self.pictures if scene == self.scene else self.relit_truths(scene)
            self._distances[name, scene] = StyleRatio(self.styles[name], truths)
        return self._distances[name, scene].of(pictures)

    def style_ratio_of(self, maps: MapSet, intensity: Intensity) -> float:
        """Style ratio of the maps' central square; `intensity` as of `relit`."""
        return self.style_ratio(self.relit(self.middle(maps), intensity))

    def middle(self, maps: MapSet) -> MapSet:
        """Crop of maps to the central square that is compared.

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
        """Side of the compared square in texels of a size (plane units)."""
        return round(self.settings.width / texel_size)
