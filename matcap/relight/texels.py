"""Radiance of texels, seen from straight above without perspective, under one distant light.

The renderer's loop of direct light (loops/lights.c) on maps as they are: one pixel a texel, without
camera, plan and effects. For previews, where planning would take longer than rendering.
"""

from __future__ import annotations

from ctypes import byref

import numpy as np

from matcap.relight.loops.library import KeptArrays, loops
from matcap.relight.loops.structures import DIFFUSE, SPECULAR, CLamp, CPixels
from matcap.relight.scene import DirectionalLight
from matcap.relight.texture import alpha_of
from matcap.relight.vectors import Array, unit3


def light_texels(
    diffuse: Array, specular: Array, roughness: Array, normal: Array, light: DirectionalLight
) -> Array:
    """(3, H, W) radiance of maps, all float32 and channels first.

    Args:
        diffuse: (3, H, W) albedo.
        specular: (1 or 3, H, W) F0.
        roughness: (1, H, W) perceptual roughness.
        normal: (3, H, W) unit normals, y up.
    """
    kept, total = KeptArrays(), np.zeros(diffuse.shape, dtype=np.float32)
    flat, upright = np.zeros_like(roughness[0]), np.ones_like(roughness[0])
    straight = (kept.of(flat), kept.of(flat), kept.of(upright))
    pixels = CPixels(
        count=flat.size,
        point=straight,
        view=straight,
        normal=tuple(kept.of(axis) for axis in normal),
        n_dot_v=kept.of(np.maximum(normal[2], np.float32(0.0))),
        alpha=kept.of(alpha_of(roughness)),
        diffuse=tuple(kept.of(channel) for channel in diffuse),
        specular=tuple(kept.of(channel) for channel in np.broadcast_to(specular, diffuse.shape)),
        total=tuple(channel.ctypes.data for channel in total),
    )
    lamp = CLamp(
        place=tuple(unit3(light.direction)),
        colour=light.irradiance,
        far=1,
        power=1.0,
        parts=DIFFUSE + SPECULAR,
    )
    loops().matcap_relight_lamp(byref(pixels), byref(lamp), None)
    return total
