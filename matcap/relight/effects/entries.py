"""All effects, in the order in which plans list them.

A new one is a file in this folder and an entry here. What it may change is its bound; it acts by
`move`, before the material is read, or `add`, after the lights. Effects with neither are asked for
by the loops of the lights, through the plan.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from matcap.relight.effects import (
    area,
    direct,
    environment,
    filtering,
    interreflection,
    multiscatter,
    parallax,
    shadows,
    visibility,
)
from matcap.relight.effects.bound import Bound
from matcap.relight.relief import Relief
from matcap.relight.scene_bounds import SceneBounds
from matcap.relight.surfaces.hits import Hits
from matcap.relight.vectors import Array

if TYPE_CHECKING:
    from matcap.relight.block import Block


@dataclass(frozen=True)
class Effect:
    """One effect."""

    bound: Callable[[SceneBounds], Bound]
    """On what leaving it out could change."""
    move: Callable[[Relief, Hits], tuple[Hits, Array]] | None = None
    """Takes hits to where they truly are, and gives the height there."""
    add: Callable[[Block], None] | None = None
    """Adds to pixels that all lights have been added to."""


EFFECTS: Mapping[str, Effect] = {
    "diffuse": Effect(direct.diffuse_bound),
    "specular": Effect(direct.specular_bound),
    "falloff": Effect(direct.falloff_bound),
    "area": Effect(area.bound),
    "environment": Effect(environment.bound),
    "filtering": Effect(filtering.bound),
    "parallax": Effect(parallax.bound, move=parallax.move),
    "shadows": Effect(shadows.bound),
    "visibility": Effect(visibility.bound),
    "interreflection": Effect(interreflection.bound, add=interreflection.add),
    "multiscatter": Effect(multiscatter.bound),
}
