"""Table of all effects, in the order in which plans list them.

A new effect is a file in this folder and an entry here: its bound, and `move` (before the material
is looked up) or `add` (after all lights). Effects with neither are terms of the lights' loops.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from matcap.relight.block import Block, Hits
from matcap.relight.camera import Array
from matcap.relight.effects import Bound, area, direct, environment, multiscatter, relief
from matcap.relight.plan import SceneBounds
from matcap.relight.relief import Relief


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
    "filtering": Effect(relief.filtering_bound),
    "parallax": Effect(relief.parallax_bound, move=relief.move),
    "shadows": Effect(relief.shadows_bound),
    "visibility": Effect(relief.visibility_bound),
    "interreflection": Effect(relief.interreflection_bound, add=relief.add_interreflection),
    "multiscatter": Effect(multiscatter.bound),
}
