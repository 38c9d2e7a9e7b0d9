"""Table of all effects, in the order in which plans list them.

A new effect is a file in this folder and an entry here: its bound, and `move` (before the material
is looked up) or `add` (after all lights). Effects with neither are terms of the lights' loops.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from matcap.relight.block import Block
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


@dataclass(frozen=True)
class Effect:
    """An effect: its bound, and the stage in which it acts."""

    bound: Callable[[SceneBounds], Bound]
    """Upper bound on the change from leaving it out."""
    move: Callable[[Relief, Hits], tuple[Hits, Array]] | None = None
    """Displaces hits; returns them and the height there."""
    add: Callable[[Block], None] | None = None
    """Adds radiance to a block after all lights."""


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
