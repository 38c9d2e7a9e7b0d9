"""Maps in a scene to a picture."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.relight.camera import View, view_of
from matcap.relight.lobes import ggx_smith, schlick_weight
from matcap.relight.sampling import Sample, Sampler
from matcap.relight.scene import Film, PointLight, Scene, scene_from_light
from matcap.relight.surfaces.hits import Hits
from matcap.relight.surfaces.plane import plane_hits
from matcap.relight.texture import Texture
from matcap.relight.vectors import Array, Vec, dot, scale, subtract, vec

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet

# Pixels shaded together: their two dozen arrays should stay in a core's own cache.
_BLOCK = 16384
# Texels across the plane's default long side that a material is read at most.
_LARGEST_READ = 8192


class MapSource(Protocol):
    """A material: something that maps of any size can be read from."""

    @property
    def texel_size(self) -> float:
        """In plane units."""
        ...

    def maps(self, width: int, height: int, *, seed: int, x: int, y: int) -> MapSet:
        """The rectangle whose left top texel is (x, y)."""
        ...


def relight(
    source: MapSet | MapSource | Texture, scene: Scene | str = "top", *, seed: int = 0
) -> NDArray[np.float32]:
    """A picture of a material in a scene.

    Args:
        source: maps, or a material to read them from.
        scene: the scene, or what scene_from_light takes.
        seed: the realisation read from a material.

    Returns:
        (H, W, 3) float32 radiance, linear Rec.709; 0 where there is no surface. Exposure and
        transfer of the film are not applied.

    Raises:
        MatcapError: the scene asks for something that is not there.
    """
    scene = scene_from_light(scene) if isinstance(scene, str) else scene
    texture = _texture(source, scene, seed)
    film = scene.film or Film(*texture.size)
    scene = replace(scene, film=film)
    extent = _plane_extent(scene, texture)
    view = view_of(scene.camera, film, max(extent))
    sampler = Sampler(texture, scene.surface.repeat)
    picture = np.zeros((film.height, film.width, 3), dtype=np.float32)

    def rows(top: int, bottom: int) -> None:
        hits = plane_hits(view, top, bottom, extent)
        radiance = _shade(hits, sampler.read(hits.place), scene)
        if hits.seen is not None:
            radiance *= hits.seen
        picture[top:bottom] = np.moveaxis(radiance, 0, -1)

    _in_blocks(view, rows)
    return picture


def _shade(hits: Hits, sample: Sample, scene: Scene) -> NDArray[np.float32]:
    """(3, rows, W) radiance of a block."""
    shape = np.broadcast_shapes(hits.place[0].shape, hits.place[1].shape)
    radiance = np.zeros((3, *shape), dtype=np.float32)
    n_dot_v = np.maximum(dot(sample.normal, hits.to_view), np.float32(0.0))
    for light in scene.lights:
        if not isinstance(light, PointLight):
            raise MatcapError(f"{type(light).__name__} cannot be rendered yet", where="scene")
        offset = subtract(vec(light.position), hits.point)
        squared = dot(offset, offset)
        inverse = 1.0 / np.sqrt(squared)
        to_light = scale(offset, inverse)
        _add_light(radiance, sample, hits.to_view, n_dot_v, to_light, light.intensity, 1 / squared)
    return radiance


def _add_light(
    radiance: NDArray[np.float32],
    sample: Sample,
    to_view: Vec,
    n_dot_v: Array,
    to_light: Vec,
    colour: tuple[float, float, float],
    falloff: Array,
) -> None:
    n_dot_l = np.maximum(dot(sample.normal, to_light), np.float32(0.0))
    # The plane itself stands before whatever is below it, and nothing shows its back.
    received = n_dot_l * falloff * ((to_light[2] > 0.0) & (n_dot_v > 0.0))
    lobe, l_dot_h = ggx_smith(sample.normal, to_view, to_light, n_dot_v, n_dot_l, sample.alpha)
    lobe *= received
    weight = schlick_weight(l_dot_h)
    glare = [(f0 + (1.0 - f0) * weight) * lobe for f0 in sample.specular]
    received *= np.float32(1.0 / math.pi)
    for channel in range(3):
        value = sample.diffuse[channel] * received
        value += glare[channel if len(glare) == 3 else 0]
        radiance[channel] += value * np.float32(colour[channel])


def _texture(source: MapSet | MapSource | Texture, scene: Scene, seed: int) -> Texture:
    from matcap.brdf.maps import MapSet

    if isinstance(source, Texture):
        return source
    if isinstance(source, MapSet):
        return Texture.from_maps(source)
    film = scene.film or Film(1024, 1024)
    size = scene.surface.size or 2.0
    needed = size * scene.surface.repeat / source.texel_size
    across = min(_LARGEST_READ, max(1, round(needed)))
    down = min(across, max(1, round(needed * min(1.0, film.height / film.width))))
    return Texture.from_maps(source.maps(across, down, seed=seed, x=0, y=0))


def _plane_extent(scene: Scene, texture: Texture) -> tuple[float, float]:
    if scene.surface.size is None:
        width, height = texture.extent
        return width / scene.surface.repeat, height / scene.surface.repeat
    return scene.surface.size, scene.surface.size


def _in_blocks(view: View, rows: Callable[[int, int], None]) -> None:
    """Call `rows` for all rows of the picture, in blocks, on all cores."""
    width, height = view.size
    step = max(1, _BLOCK // width)
    tops = range(0, height, step)
    with ThreadPoolExecutor(_workers()) as pool:
        for _ in pool.map(lambda top: rows(top, min(top + step, height)), tops):
            pass


def _workers() -> int:
    """Cores this process may use."""
    limit = os.environ.get("OMP_NUM_THREADS", "")
    if limit.isdigit() and int(limit) > 0:
        return int(limit)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
