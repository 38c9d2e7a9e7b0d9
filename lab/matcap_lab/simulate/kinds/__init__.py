"""Random materials of nameable kinds (bricks, wood, felt), each with random parameters.

`random_material` (varied.py) draws abstract patterns; this draws gravel, knits, bonds, hammered
metal, planks. Placement and what all share are in `surface.py`, random parameters in `varied.py`;
each further file holds a group of kinds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

import numpy as np

from matcap.brdf.maps import MapSet
from matcap_lab.simulate.kinds import (
    metals_and_coats,
    stones_and_masonry,
    surface,
    wood_and_textiles,
)
from matcap_lab.simulate.kinds.surface import Kind, finish
from matcap_lab.simulate.procedural import Canvas, Raster, rms_slope
from matcap_lab.simulate.varied import Draws

__all__ = ["COLOURED_METALS", "KINDS", "RandomKind", "kind_of", "kinds_known", "random_kind"]

KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "plates": Kind(surface.plates, (0.06, 0.5)),
        "crackle": Kind(surface.crackle, (0.02, 0.12), (0.004, 0.02)),
        "gravel": Kind(stones_and_masonry.gravel, (0.2, 0.6)),
        "asphalt": Kind(stones_and_masonry.asphalt, (0.12, 0.5)),
        "terrazzo": Kind(stones_and_masonry.terrazzo, (0.02, 0.08), (0.004, 0.02)),
        "marble": Kind(stones_and_masonry.marble, (0.02, 0.06), (0.003, 0.015)),
        "pitted": Kind(stones_and_masonry.pitted, (0.06, 0.4)),
        "knit": Kind(wood_and_textiles.knit, (0.2, 0.6)),
        "cable": Kind(wood_and_textiles.cable, (0.2, 0.6)),
        "ribs": Kind(wood_and_textiles.ribs, (0.1, 0.6)),
        "weave": Kind(wood_and_textiles.weave, (0.1, 0.55)),
        "basket": Kind(wood_and_textiles.basket, (0.15, 0.6)),
        "bond": Kind(stones_and_masonry.bond, (0.07, 0.45)),
        "herringbone": Kind(stones_and_masonry.herringbone, (0.07, 0.45)),
        "hammered": Kind(metals_and_coats.hammered, (0.06, 0.35), (0.003, 0.02)),
        "brushed": Kind(metals_and_coats.brushed, (0.02, 0.15), (0.003, 0.02)),
        "planks": Kind(wood_and_textiles.planks, (0.03, 0.3)),
        "varnish": Kind(wood_and_textiles.varnish, (0.02, 0.15), (0.003, 0.015)),
        "chipboard": Kind(wood_and_textiles.chipboard, (0.05, 0.35)),
        "scales": Kind(wood_and_textiles.scales, (0.1, 0.5)),
        "felt": Kind(wood_and_textiles.felt, (0.15, 0.55)),
        "loops": Kind(wood_and_textiles.loops, (0.15, 0.6)),
        "tread": Kind(wood_and_textiles.tread, (0.05, 0.35), (0.003, 0.03)),
        "paper": Kind(wood_and_textiles.paper, (0.02, 0.1), (0.004, 0.03)),
        "creased": Kind(wood_and_textiles.creased, (0.06, 0.45), (0.004, 0.03)),
        "chipped": Kind(metals_and_coats.chipped, (0.05, 0.35)),
        "worn": Kind(metals_and_coats.worn, (0.05, 0.35)),
        "strokes": Kind(metals_and_coats.strokes, (0.06, 0.4)),
        "sand": Kind(metals_and_coats.sand, (0.12, 0.5)),
    }
)

# Metals whose F0 has a colour, by name alone: `random_kind`, which training draws from, has none.
COLOURED_METALS: Mapping[str, Kind] = MappingProxyType(
    {
        "anodised": Kind(metals_and_coats.anodised, (0.02, 0.1), (0.003, 0.015), 0.0),
        "streaked": Kind(
            partial(metals_and_coats.tinted, metals_and_coats.brushed),
            (0.03, 0.15),
            (0.003, 0.02),
            0.0,
        ),
        "beaten": Kind(
            partial(metals_and_coats.tinted, metals_and_coats.hammered),
            (0.06, 0.35),
            (0.003, 0.02),
            0.0,
        ),
        "rusted": Kind(metals_and_coats.rusted, (0.06, 0.25), (0.004, 0.03), 0.0),
        "leafed": Kind(metals_and_coats.leafed, (0.03, 0.12), (0.003, 0.02), 0.0),
        **{
            name: Kind(surface, (0.015, 0.08), (0.002, 0.012), 0.0)
            for name, surface in metals_and_coats.SHEETS.items()
        },
    }
)

# The sample on which a relief's slope is measured: width, height in texels, size in plane units.
_SAMPLE = (256, 192, 2.0 / 512.0)


@dataclass(frozen=True)
class RandomKind:
    """A material of a kind of kinds_known(), with random parameters.

    `number` is their seed, `depth` the plane units per unit of height.
    """

    kind: str
    number: int
    depth: float

    def realise(self, width: int, height: int, seed: int, texel_size: float) -> MapSet:
        """One realisation, float64 (C, height, width); see materials.realise."""
        canvas = Canvas(width, height, texel_size, seed)
        return self._finished(canvas, self.depth)[0]

    def _finished(self, canvas: Canvas, depth: float) -> tuple[MapSet, Raster]:
        return finish(canvas, kinds_known()[self.kind], depth, Draws.of(self.number))


def kinds_known() -> Mapping[str, Kind]:
    """KINDS and COLOURED_METALS by name."""
    return {**KINDS, **COLOURED_METALS}


def random_kind(rng: np.random.Generator) -> RandomKind:
    """Draw a material of any of KINDS, all equally often."""
    names = list(KINDS)
    return kind_of(names[rng.integers(len(names))], int(rng.integers(2**32)))


def kind_of(kind: str, number: int) -> RandomKind:
    """The material of a kind with parameters of seed `number`."""
    steepness = Draws.of([number, 1]).log_uniform(*kinds_known()[kind].slopes)
    width, height, texel = _SAMPLE
    relief = RandomKind(kind, number, 1.0)._finished(Canvas(width, height, texel, 0), 1.0)[1]
    return RandomKind(kind, number, steepness / max(rms_slope(relief, texel), 1e-9))
