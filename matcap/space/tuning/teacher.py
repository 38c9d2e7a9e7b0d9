"""The exemplar's maps as a teacher of a decoder that reads its drawing.

In every step of fine-tuning a window of one field of the exemplar is drawn, and the decoder's maps
m are compared with the field's own, m', besides the texture distance to the photograph:

    3 mean |log R_l - log R'_l| + mean |logit m - logit m'| + 0.1 mean |log S_k / S'_k|,

m the diffuse albedo, F0 and roughness, R_l the radiance under a far light l 53 degrees off the
normal, of which every step takes two, S_k the mean squared slope in octave k. Without the last term
stains become slow relief, which a flash hardly tells from them. Figures in docs/notes/prior.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.brdf.slopes import relief_difference
from matcap.field.plane import Rectangle
from matcap.flash.light import FlashLight
from matcap.space.decoder import ALIGNMENT
from matcap.space.drawing import AROUND, Drawing

_LIT, _RELIEF = 3.0, 0.1  # weights of radiance and of slopes; docs/notes/prior.md
_FLAT = 0.005  # root-mean-square slope of an octave that is added to both
_LIGHTS = (
    (-0.8, 0.0, 0.6), (0.8, 0.0, 0.6), (0.0, 0.8, 0.6),
    (0.0, -0.8, 0.6), (0.57, 0.57, 0.6), (-0.57, 0.57, 0.6),
)  # fmt: skip
MARGIN = ALIGNMENT  # texels around a window that are decoded too
_AT_ONCE = 2  # lights in a step
_DARKEST = 0.01  # added to radiance before the logarithm
_LOGIT_EPSILON = 1e-3  # of albedo, F0 and roughness: bounds the logit at 0 and 1


@dataclass(frozen=True)
class Lesson:
    """A window of the teacher's field."""

    drawing: tuple[Tensor, ...]
    """Drawing.levels of the window and MARGIN around it."""
    maps: MapSet
    """Its maps, (1, ., size, size)."""
    seed: int
    """Of the choice of lights."""

    def loss(self, maps: MapSet) -> Tensor:
        """How far maps (1, ., size, size) are from the window's; see the module's equation."""
        generator = torch.Generator().manual_seed(self.seed)
        chosen = torch.randperm(len(_LIGHTS), generator=generator)[:_AT_ONCE].tolist()
        lit = [
            (_log_radiance(maps, _LIGHTS[n]) - _log_radiance(self.maps, _LIGHTS[n])).abs().mean()
            for n in chosen
        ]
        return (
            _LIT * torch.stack(lit).mean()
            + (_logits(maps) - _logits(self.maps)).abs().mean()
            + _RELIEF * relief_difference(maps, self.maps, _FLAT).mean()
        )


@dataclass(frozen=True)
class Teacher:
    """One field of the exemplar, at least as large, from which windows are taken."""

    drawing: Drawing
    field: Tensor
    """Stacked maps, with what the drawing needs around them."""
    size: int
    """Side of a window, texels."""

    @staticmethod
    def of(drawing: Drawing, size: int, seed: int) -> Teacher:
        """A field of a seed."""
        width, height = (max(side, size + 2 * MARGIN) for side in drawing.example.exemplar.size)
        return Teacher(drawing, drawing.around(seed, Rectangle(0, 0, width, height)), size)

    def lesson(self, seed: int) -> Lesson:
        """A window at random."""
        beyond = AROUND + MARGIN
        whole, generator = self.size + 2 * beyond, torch.Generator().manual_seed(seed)
        y, x = (
            int(torch.randint(side - whole + 1, (), generator=generator))
            for side in self.field.shape[1:]
        )
        read = self.field[:, y : y + whole, x : x + whole]
        maps = read[None, :, beyond:-beyond, beyond:-beyond]
        texel_size = self.drawing.example.exemplar.texel_size
        return Lesson(self.drawing.levels_of(read), MapSet.from_stacked(maps, texel_size), seed)


def _log_radiance(maps: MapSet, light: tuple[float, float, float]) -> Tensor:
    """(1, 3, H, W) log radiance under a far light, seen from straight above."""
    far = FlashLight.far(maps.diffuse.new_tensor(light))
    lit = far.onto(maps.normal, exact=True).radiance(maps.diffuse, maps.specular, maps.roughness)
    return (lit.clamp_min(0.0) + _DARKEST).log()


def _logits(maps: MapSet) -> Tensor:
    """(1, 5, H, W) logits of diffuse albedo, mean F0 and roughness."""
    specular = maps.specular.mean(dim=1, keepdim=True)
    return torch.logit(torch.cat([maps.diffuse, specular, maps.roughness], 1), eps=_LOGIT_EPSILON)
