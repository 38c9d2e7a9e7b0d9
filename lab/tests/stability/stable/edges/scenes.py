"""Meshes against a brute search, and whole scenes whose every number may be extreme."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError
from matcap.files.exr import write_exr
from matcap.relight.camera import view_of
from matcap.relight.render import Renderer
from matcap.relight.scene import (
    Camera,
    DirectionalLight,
    EnvironmentLight,
    Film,
    Light,
    PointLight,
    RectangleLight,
    Scene,
    SphereLight,
    Surface,
    Vector,
)
from matcap.relight.surfaces import load_mesh
from stable.edges.swept import Swept, compared, log_uniform

Values = NDArray[np.float64]
_FILM = Film(48, 36)
_PICTURE = Film(24, 18)  # of a scene
_EDGE = 1e-4  # of a triangle: nearer to its border a pixel may be the neighbour's


def meshes(g: np.random.Generator) -> Swept:
    """Where rays meet triangles, against all of them tried one by one; in sizes of the mesh."""
    count = int(g.integers(1, 30))
    corners = g.normal(size=(count, 3, 3)) * log_uniform(g, 1e-3, 1.0, (count, 1, 1))
    corners += g.normal(size=(count, 1, 3))
    if g.integers(2):  # lines and points among them
        corners[g.integers(count)] = corners[0, 0]
    extent = float(log_uniform(g, 1e-300, 1e300)) if g.integers(4) == 0 else 1.0
    perspective = bool(g.integers(2))
    with tempfile.TemporaryDirectory() as folder:
        mesh = load_mesh(_written(Path(folder), corners * extent), 2.0)
    camera = Camera("perspective" if perspective else "orthographic", (1.0, 2.0, 4.0))
    view = view_of(camera, _FILM, 2.0)
    hits = mesh.seen_by(view).hits(view, 0, _FILM.height)
    origin, direction = view.rays(0, _FILM.height)
    depth, sure = _nearest(mesh.corners, np.moveaxis(origin, 0, -1), np.moveaxis(direction, 0, -1))
    assert hits.seen is not None
    point = np.moveaxis(np.stack(np.broadcast_arrays(*hits.point)), 0, -1)
    away = np.linalg.norm(point - np.moveaxis(origin, 0, -1), axis=-1)
    found = np.where(hits.seen, away, 0.0)
    expected = np.where(np.isfinite(depth), depth, 0.0)
    return compared(
        found[sure], expected[sure], 2.0, f"{count} triangles of extent {extent:.2g}"
    ) if sure.any() else Swept(1)  # fmt: skip


def _nearest(
    corners: Values, origin: Values, direction: Values
) -> tuple[Values, NDArray[np.bool_]]:
    """(H, W) distance of the nearest triangle seen from its front; and where that is certain."""
    depth = np.full(origin.shape[:2], np.inf)
    sure = np.ones(origin.shape[:2], bool)
    for a, b, c in corners:
        edge1, edge2 = b - a, c - a
        normal = np.cross(edge1, edge2)
        if not np.linalg.norm(normal) > 0.0:
            continue
        facing = -(direction @ normal)
        p = np.cross(direction, edge2)
        determinant = p @ edge1
        safe = np.where(np.abs(determinant) > 1e-30, determinant, np.inf)
        s = origin - a
        u = (s * p).sum(-1) / safe
        q = np.cross(s, edge1)
        v = (direction * q).sum(-1) / safe
        along = (q @ edge2) / safe
        inner = np.minimum(np.minimum(u, v), 1.0 - u - v)
        front = (facing > 0.0) & (along > 0.0)
        struck = front & (inner > 0.0)
        # On a border, edge on, or as near as another one: either answer will do.
        unsure = (np.abs(inner) < _EDGE) | (np.abs(facing) < 1e-6 * np.linalg.norm(normal))
        unsure |= struck & (np.abs(along - depth) < 1e-6)
        sure &= ~unsure
        depth = np.where(struck, np.minimum(depth, along), depth)
    return depth, sure


def scenes(g: np.random.Generator) -> Swept:
    """Any scene of any numbers: a picture of finite radiance, not negative, or one sentence."""
    with tempfile.TemporaryDirectory() as folder:
        scene = _scene(g, Path(folder))
        maps = _maps(g)
        effects = str(g.choice(["auto", "all"]))
        try:
            picture = Renderer(maps, scene).render(effects=effects).radiance
        except MatcapError as error:
            named = bool(error.what and error.remedy)
            return Swept(1, broken=not named, refused=named)
        except Warning as error:
            raise RuntimeError(f"{error} in {scene} of {maps.texel_size:.2g}") from error
    broken = int((~np.isfinite(picture) | (picture < 0.0)).sum())
    return Swept(picture.size, broken, where=f"{scene}" if broken else "")


def _maps(g: np.random.Generator) -> MapSet:
    """A few texels of anything between a mirror and chalk, a film and a cliff."""
    width, height = (int(side) for side in g.integers(1, 17, 2))

    def field(planes: int) -> torch.Tensor:
        ends = g.choice([0.0, 0.04, 0.5, 1.0], 2)
        drawn = ends.min() + np.ptp(ends) * g.random((planes, height, width))
        return torch.from_numpy(drawn).float()

    lift = float(log_uniform(g, 1e-12, 1e8) * g.integers(2))
    return MapSet(
        field(3), field(1), field(1), lift * field(1), float(log_uniform(g, 1e-6, 1e2)),
        periodic=bool(g.integers(2)),
    )  # fmt: skip


def _scene(g: np.random.Generator, folder: Path) -> Scene:
    kind = str(g.choice(["plane", "plane", "sphere", "cylinder", "mesh"]))
    camera = None
    if g.integers(3):
        camera = Camera(
            "perspective" if g.integers(2) else "orthographic",
            _place(g), (0.0, 0.0, 0.0), float(g.uniform(0.1, 179.0)),
            float(log_uniform(g, 1e-6, 1e6)),
        )  # fmt: skip
    surface = Surface(
        kind,  # type: ignore[arg-type]
        float(log_uniform(g, 1e-4, 1e4)) if kind != "plane" or g.integers(2) else None,
        _written(folder, g.normal(size=(8, 3, 3))) if kind == "mesh" else None,
        float(log_uniform(g, 1e-3, 1e3)),
        float(log_uniform(g, 1e-6, 1e6) * g.choice([0.0, 1.0])),
    )
    lights = tuple(_light(g, folder) for _ in range(int(g.integers(1, 4))))
    return Scene(_PICTURE, camera, surface, lights)


def _light(g: np.random.Generator, folder: Path) -> Light:
    red, green, blue = (
        float(c) for c in log_uniform(g, 1e-30, 1e30) * g.choice([0.0, 1.0, 1.0], 3)
    )
    colour = (red, green, blue)
    kind = int(g.integers(11)) // 2
    if kind == 0:
        return PointLight(_place(g), colour)
    if kind == 1:
        return DirectionalLight(_place(g), colour)
    if kind == 2:
        return SphereLight(_place(g), float(log_uniform(g, 1e-6, 1e6)), colour)
    if kind == 3:
        sides = log_uniform(g, 1e-6, 1e6, 2)
        return RectangleLight(
            _place(g), _place(g), _place(g), (float(sides[0]), float(sides[1])), colour
        )
    if kind == 4:
        return EnvironmentLight(radiance=colour)
    picture = np.full((16, 32, 3), g.choice([0.0, 1.0]), np.float32)
    picture[g.integers(16), g.integers(32)] = log_uniform(g, 1e-3, 1e30)
    file = folder / f"sky{g.integers(10**9)}.exr"
    write_exr(file, picture, half=False)
    return EnvironmentLight(file, float(log_uniform(g, 1e-6, 1e6)), float(g.uniform(-1e4, 1e4)))


def _place(g: np.random.Generator) -> Vector:
    """Anywhere, near, far, low, or straight above."""
    x, y, z = g.normal(size=3) * log_uniform(g, 1e-6, 1e6) * g.choice([0.0, 1e-6, 1.0, 1.0], 3)
    return float(x), float(y), float(abs(z)) + (0.0 if x or y or z else 1.0)


def _written(folder: Path, corners: Values) -> Path:
    """Triangles (F, 3, 3) as a Wavefront OBJ."""
    path = folder / "mesh.obj"
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in corners.reshape(-1, 3).tolist()]
    lines += [f"f {3 * i + 1} {3 * i + 2} {3 * i + 3}" for i in range(len(corners))]
    path.write_text("\n".join(lines) + "\n")
    return path
