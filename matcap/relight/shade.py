"""Radiance of a block of pixels: displace hits, look up the material, add lights, add effects.

The loops of matcap.relight.loops do the work. With a budget an effect runs in the pixels whose own
bound exceeds it, without one in all.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from matcap.relight.block import Block, ShadingContext
from matcap.relight.effects import area, direct, environment
from matcap.relight.effects.entries import EFFECTS
from matcap.relight.sampling import SurfaceSample
from matcap.relight.scene import EnvironmentLight, RectangleLight, SphereLight
from matcap.relight.surfaces.hits import Hits
from matcap.relight.vectors import Array

# Effects that run in every pixel if they run at all.
_EVERYWHERE = ("diffuse", "specular", "falloff", "filtering", "parallax", "multiscatter")


def shade(context: ShadingContext, hits: Hits, tiles: Array) -> Array:
    """(3, rows, W) radiance of a block; 0 where rays miss the surface.

    Args:
        hits: intersections of the block's rays, (rows, W).
        tiles: (rows, W) index of the picture's tile of each pixel.
    """
    index = None if hits.seen is None else np.flatnonzero(hits.seen)
    with np.errstate(over="ignore", invalid="ignore"):  # render.py names the light
        block = _block(context, hits, index, tiles)
        _light(block)
    if index is None:
        return block.total.reshape(3, *tiles.shape)
    picture = np.zeros((3, tiles.size), dtype=np.float32)
    picture[:, index] = block.total
    return picture.reshape(3, *tiles.shape)


def _block(context: ShadingContext, hits: Hits, index: Array | None, tiles: Array) -> Block:
    """Hits on the displaced surface and the material there, of the pixels in `index`."""
    plan, tally, sampler = context.plan, context.tally, context.sampler
    flat = hits.flat(index, tiles.shape)
    height: Array | None = None
    for name, effect in EFFECTS.items():
        if effect.move is not None and plan.on(name):
            with tally.timed(name):
                flat, height = effect.move(context.relief, flat)
    if height is None and plan.on("shadows"):
        height = context.relief.at(*flat.place)
    with tally.timed("filtering" if plan.on("filtering") else "reading"):
        if plan.on("filtering"):
            sample = sampler.read(flat.place, flat.footprint)
        elif index is None and height is None:
            # Unflattened places let the sampler see that pixels are texels: no interpolation.
            sample = _flattened(sampler.read(hits.place), tiles.shape)
        else:
            sample = sampler.read(flat.place)
    tiles = tiles.ravel() if index is None else tiles.reshape(-1)[index]
    return Block(context, flat, height, sample, tiles)


def _flattened(sample: SurfaceSample, shape: tuple[int, ...]) -> SurfaceSample:
    """The sample broadcast to a block, row by row."""

    def every(array: Array) -> Array:
        return np.broadcast_to(array, shape).ravel()

    x, y, z = (every(one) for one in sample.normal)
    return replace(
        sample,
        diffuse=tuple(every(one) for one in sample.diffuse),
        specular=tuple(every(one) for one in sample.specular),
        alpha=every(sample.alpha),
        normal=(x, y, z),
    )


def _light(block: Block) -> None:
    """Add every light, then the effects computed from their sum."""
    context, plan = block.context, block.plan
    for name in _EVERYWHERE:
        if plan.on(name):
            block.ran(name)
    # Environments last: the budget allows more where a pixel is already bright.
    for light in context.scene.lights:
        if isinstance(light, SphereLight | RectangleLight) and plan.on("area"):
            area.add(block, light)
        elif not isinstance(light, EnvironmentLight):
            direct.add(block, light)
    for one in context.environments:
        environment.add(block, one)
    for name, effect in EFFECTS.items():
        if effect.add is not None and plan.on(name):
            with context.tally.timed(name):
                effect.add(block)
    if not block.facing.all():
        block.total *= block.facing
