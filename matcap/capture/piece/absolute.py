"""How bright the flash was, which one photograph does not tell: the most probable answer.

Twice the albedo and F0 under half the flash is the same picture. What decides is what materials are
like: nearly all that are no metal mirror 4 % (F0 of an index of refraction of 1.5) whatever their
albedo, which spreads over two orders of magnitude; metals mirror most and have no diffuse albedo.
So where a highlight tells F0 over albedo, it tells both: black leather whose gloss is three times
its albedo is black. docs/notes/exemplar.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from matcap.example.exemplar import Exemplar

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # Rec.709
_LEAST = 1e-4  # of albedo and F0


@dataclass(frozen=True)
class MaterialKind:
    """What a kind of material is like: natural logarithms, mean and deviation.

    Attributes:
        share: of all that people photograph.
        albedo: of its mean luminance.
        specular: of its mean F0.
    """

    share: float
    albedo: tuple[float, float]
    specular: tuple[float, float]

    def scale(self, albedo: float, specular: float) -> tuple[float, float]:
        """(log of the most probable factor of both, log of how probable they are at best).

        Args:
            albedo, specular: their logarithms, as fitted.
        """
        off = (self.albedo[0] - albedo, self.specular[0] - specular)
        weight = (self.albedo[1] ** -2, self.specular[1] ** -2)
        factor = (off[0] * weight[0] + off[1] * weight[1]) / sum(weight)
        spread = math.hypot(self.albedo[1], self.specular[1])
        return factor, math.log(self.share / spread) - 0.5 * ((off[0] - off[1]) / spread) ** 2


@dataclass(frozen=True)
class ScaleSettings:
    """What materials are believed to be like; 78 map sets of artists and scanners are so.

    Attributes:
        kinds: of materials. A wider F0 of what is no metal believes the flash's fitted strength
            more, and makes black things grey.
        brightest: mean and, for single texels (`most_of`), limits of albedo and F0.
        most_of: quantile that counts as the brightest texel.
    """

    kinds: tuple[MaterialKind, ...] = (
        MaterialKind(0.93, (math.log(0.15), 1.0), (math.log(0.04), 0.25)),
        MaterialKind(0.07, (math.log(0.01), 1.5), (math.log(0.5), 0.5)),
    )
    brightest: float = 0.95
    most_of: float = 0.999


SCALE = ScaleSettings()


def most_probable_scale(exemplar: Exemplar) -> float:
    """The factor by which albedo and F0 are to be larger, and the flash weaker."""
    albedo = float(np.tensordot(_LUMINANCE, exemplar.diffuse, 1).mean())
    specular = float(exemplar.specular.mean())
    logs = [math.log(max(value, _LEAST)) for value in (albedo, specular)]
    factor = max((kind.scale(*logs) for kind in SCALE.kinds), key=lambda found: found[1])[0]
    most = max(_most(exemplar.diffuse), _most(exemplar.specular))
    return min(math.exp(factor), max(SCALE.brightest / most, 1.0))


def scaled(exemplar: Exemplar, factor: float) -> Exemplar:
    """The same under a flash so many times weaker."""
    return replace(
        exemplar,
        diffuse=(exemplar.diffuse * np.float32(factor)).clip(0.0, 1.0),
        specular=(exemplar.specular * np.float32(factor)).clip(0.0, 1.0),
    )


def _most(plane: NDArray[np.float32]) -> float:
    return max(float(np.quantile(plane, SCALE.most_of)), _LEAST)
