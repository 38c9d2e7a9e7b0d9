"""Surfaces of scenes: plane, sphere, cylinder and triangle meshes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from matcap.errors import MatcapError
from matcap.files.names import note
from matcap.relight.block import Hits, Shape, to_frame
from matcap.relight.camera import Array, Vec, View, dot, scale, subtract, vec
from matcap.relight.plan import VisibleRegion
from matcap.relight.relief import Relief
from matcap.relight.scene import Film, Surface
from matcap.relight.texture import Texture

# Sphere and cylinder around the origin, seen from outside.
#
# (u, v) = (radius longitude, radius latitude or y), with 0 at +z: true to size on the equator,
# squeezed towards a sphere's poles. The cylinder is upright and open. Displacement moves lookups in
# the tangent plane; outlines stay smooth.


# Picture's short side over a curved surface's diameter, with the default camera.
_MARGIN = 1.25


@dataclass(frozen=True)
class Round(Shape):
    """A sphere, or an upright cylinder as high as it is wide."""

    radius: float
    cylinder: bool

    def framed(self, film: Film) -> float:
        """Span of the picture's long side at the origin that shows all of it, plane units."""
        sides = max(film.width, film.height) / min(film.width, film.height)
        return 2.0 * self.radius * _MARGIN * sides

    def hits(self, view: View, top: int, bottom: int) -> Hits:
        """Intersections of the rays of rows [top, bottom) of the picture."""
        origin, direction = view.rays(top, bottom)
        # Seen along y, a cylinder is a circle.
        axes = np.array([1.0, 0.0 if self.cylinder else 1.0, 1.0])[:, None, None]
        o, d = origin * axes, direction * axes
        along, seen = _nearest((d * d).sum(0), (o * d).sum(0), (o * o).sum(0) - self.radius**2)
        point = origin + along * direction
        if self.cylinder:
            seen = seen & (np.abs(point[1]) <= self.radius)
            longitude, up = np.arctan2(point[0], point[2]), point[1]
            zero = np.zeros_like(longitude)
            sine, cosine = np.sin(longitude), np.cos(longitude)
            tangent, normal = np.stack([cosine, zero, -sine]), np.stack([sine, zero, cosine])
            bitangent = np.stack([zero, zero + 1.0, zero])
        else:
            normal = point / np.maximum(np.sqrt((point * point).sum(0)), 1e-30)
            longitude = np.arctan2(normal[0], normal[2])
            up = self.radius * np.arcsin(np.clip(normal[1], -1.0, 1.0))
            zero = np.zeros_like(longitude)
            tangent = np.stack([np.cos(longitude), zero, -np.sin(longitude)])
            bitangent = np.cross(normal, tangent, axis=0)
        frame, place = (tangent, bitangent, normal), (self.radius * longitude, up)
        return hits_of(view, point, frame, place, seen, along, direction)

    def region(self, view: View, relief: Relief) -> tuple[VisibleRegion, float]:
        """Box around the visible points; footprints are unbounded towards the outline."""
        r = self.radius + max(abs(relief.low), abs(relief.high))
        return VisibleRegion((-r, -r, -r), (r, r, r), flat=False), math.inf


def hits_of(
    view: View,
    point: Array,
    axes: tuple[Array, Array, Array],
    place: tuple[Array, Array],
    seen: Array,
    along: Array,
    direction: Array,
) -> Hits:
    """Hits of rays on a curved surface.

    Args:
        point: (3, rows, W) intersections.
        axes: tangent, bitangent and normal there, (3, rows, W) unit vectors.
        place: (u, v) on the material, (rows, W).
        seen: (rows, W) False where rays miss.
        along: (rows, W) distances along the rays.
        direction: (3, rows, W) unit vectors of the rays.
    """
    frame = (_vec(axes[0]), _vec(axes[1]), _vec(axes[2]))
    to_view = to_frame(_vec(-direction), frame)
    pixel = view.pixel * (along if view.perspective else np.ones_like(along))
    footprint = (pixel / np.maximum(to_view[2], 1e-3)).astype(np.float32)
    # Rays that miss look up the middle of the material: any valid place.
    u, v = (np.where(seen, one, 0.0) for one in place)
    footprint = np.where(seen, footprint, np.float32(0.0))
    return Hits(_vec(point), frame, (u, v), to_view, np.asarray(seen), footprint)


def _nearest(a: Array, half_b: Array, c: Array) -> tuple[Array, Any]:
    """The smaller root of a t^2 + 2 half_b t + c = 0, and where it is real and positive."""
    inside = half_b * half_b - a * c
    seen = (inside > 0.0) & (a > 1e-12)
    safe = np.where(seen, a, 1.0)
    along = (-half_b - np.sqrt(np.maximum(inside, 0.0))) / safe
    seen = seen & (along > 0.0)
    return np.where(seen, along, 1.0), seen


def _vec(array: Array) -> Vec:
    x, y, z = array.astype(np.float32)
    return x, y, z


# A triangle mesh from a Wavefront OBJ file, centred on the origin and scaled to its size.
#
# - Faces of more than three corners are split into triangle fans. - Normals are the file's; where
# it has none, averages over a vertex's faces, weighted by area. - (u, v) are the file's texture
# coordinates, scaled so that the material is true to size on average; without any, x and y. -
# Visibility is a depth buffer at pixel centres. Back faces, and triangles that reach behind the
# camera, are not drawn. - The mesh casts no shadows on itself; surfaces that face away from a light
# are dark.


# Pairs of a triangle and a pixel that are rasterised together, to bound memory.
_PAIRS = 4_000_000
_MESH_MARGIN = 1.1  # picture's short side over the mesh's longest
_SMALLEST = 1e-12  # least area of a triangle, over half the size squared
_NOWHERE = 2**62  # an index beyond any table
_FARTHEST_SPOT = 1e6  # largest texture coordinate: single precision resolves no texels beyond


@dataclass(frozen=True)
class Mesh(Shape):
    """Triangles with attributes of their corners."""

    corners: Array
    """(F, 3, 3) positions in the scene."""
    normals: Array
    """(F, 3, 3) unit vectors."""
    places: Array
    """(F, 3, 2) (u, v) on the material in plane units."""
    seen: Array = field(default_factory=lambda: np.full((0, 0), -1))
    """(rows, W) index of the visible triangle of each pixel, or -1; filled by seen_by()."""

    def framed(self, film: Film) -> float:
        """Span of the picture's long side at the origin that shows all of it, plane units."""
        size = np.ptp(self.corners.reshape(-1, 3), axis=0)
        long, short = max(film.width, film.height), min(film.width, film.height)
        # The longest side fits the picture's short side; + depth, for perspective.
        return float(size.max() * _MESH_MARGIN * long / short + size[2])

    def seen_by(self, view: View) -> Mesh:
        """This shape, prepared for a view."""
        return Mesh(self.corners, self.normals, self.places, _visible(self.corners, view))

    def hits(self, view: View, top: int, bottom: int) -> Hits:
        """Intersections of the rays of rows [top, bottom) of the picture."""
        face = self.seen[top:bottom, slice(*view.across)]
        seen = face >= 0
        face = np.where(seen, face, 0)
        origin, direction = view.rays(top, bottom)
        a, b, c = (np.moveaxis(self.corners[face, i], -1, 0) for i in range(3))
        along, u, v = _meet(origin, direction, a, b, c)
        weights = np.stack([1.0 - u - v, u, v], axis=-1)[..., None]
        normal = np.moveaxis((self.normals[face] * weights).sum(axis=-2), -1, 0)
        normal = normal / np.maximum(np.sqrt((normal * normal).sum(0)), 1e-12)
        place = (self.places[face] * weights).sum(axis=-2)
        tangents, handedness = self._tangents
        tangent = np.moveaxis(tangents[face], -1, 0)
        tangent = tangent - normal * (normal * tangent).sum(0)
        length = np.sqrt((tangent * tangent).sum(0))
        tangent = np.where(length > 1e-9, tangent / np.maximum(length, 1e-9), _aside(normal))
        # Mirrored texture coordinates reverse the bitangent.
        bitangent = np.cross(normal, tangent, axis=0) * handedness[face]
        along = np.where(seen, along, 1.0)
        point = origin + along * direction
        spot = (place[..., 0], place[..., 1])
        axes = (tangent, bitangent, normal)
        return hits_of(view, point, axes, spot, seen, along, direction)

    def region(self, view: View, relief: Relief) -> tuple[VisibleRegion, float]:
        """Box around the visible points, and the largest side of a pixel's footprint."""
        lift = max(abs(relief.low), abs(relief.high))
        low = (self.corners.min(axis=(0, 1)) - lift).tolist()
        high = (self.corners.max(axis=(0, 1)) + lift).tolist()
        return VisibleRegion(tuple(low), tuple(high), flat=False), float("inf")

    @property
    def _tangents(self) -> tuple[Array, Array]:
        """(F, 3) dP/du of each triangle, not normalised, 0 where (u, v) are degenerate.

        And (F,) -1 where (u, v) are mirrored, else 1.
        """
        edge1, edge2 = (self.corners[:, i] - self.corners[:, 0] for i in (1, 2))
        d1, d2 = (self.places[:, i] - self.places[:, 0] for i in (1, 2))
        area = d1[:, 0] * d2[:, 1] - d2[:, 0] * d1[:, 1]
        safe = np.where(np.abs(area) > 1e-18, area, np.inf)
        tangents = (edge1 * d2[:, 1:] - edge2 * d1[:, 1:]) / safe[:, None]
        return tangents, np.where(area < 0.0, -1.0, 1.0)


def load_mesh(path: Path, size: float) -> Mesh:
    """Read a mesh; its bounding box is centred on the origin, with `size` as longest side.

    Raises:
        MatcapError: missing, no triangles, none with an area, or a face whose vertex is missing.
    """
    where = str(path)
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except FileNotFoundError as error:
        raise MatcapError.at(where, "no such file", "check the path") from error
    except OSError as error:
        raise MatcapError.at(
            where, f"the file cannot be read ({error.strerror})", "check its rights"
        ) from error
    points, spots, normals, faces = _parse(lines, where)
    corners = points[faces[..., 0]]
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    extent = float(np.ptp(points, axis=0).max())
    if not extent > 0.0:
        raise MatcapError.at(where, "all vertices are in one place", "export it again")
    corners = (corners - middle) * (size / extent)
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(flat, axis=1)
    if not (area > _SMALLEST * size**2).any():
        raise MatcapError.at(
            where,
            "no triangle has an area: the corners of each lie on a line or in one place",
            "export the mesh again",
        )
    corner_normals = _normals(points, normals, faces, flat)
    if (faces[..., 1] >= 0).all() and len(spots):
        places = spots[faces[..., 1]]
        if not (np.abs(places) < _FARTHEST_SPOT).all():
            raise MatcapError.at(
                where, f"has texture coordinates beyond {_FARTHEST_SPOT:g}", "export it again"
            )
        d1, d2 = places[:, 1] - places[:, 0], places[:, 2] - places[:, 0]
        spread = np.abs(d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]).sum()
        places = places * (area.sum() / spread) ** 0.5 if spread > 0.0 else corners[..., :2]
    else:
        places = corners[..., :2]
    return Mesh(corners, corner_normals, places)


def _normals(points: Array, normals: Array, faces: Array, flat: Array) -> Array:
    """(F, 3, 3) unit normals of corners: the file's; averages where it has none or 0.

    Args:
        points: (V, 3) vertices.
        normals: (N, 3) of the file.
        faces: (F, 3, 3) indices of vertex, texture coordinates and normal of each corner.
        flat: (F, 3) face normals times twice the area: large faces weigh more.
    """
    total = np.zeros_like(points)
    for corner in range(3):
        np.add.at(total, faces[:, corner, 0], flat)
    vertex_normals = total[faces[..., 0]]
    stated = faces[..., 2] >= 0
    if stated.any():
        own = normals[np.maximum(faces[..., 2], 0)]
        stated &= np.isfinite(own).all(axis=-1) & (np.abs(own).max(axis=-1) > 0.0)
        vertex_normals[stated] = own[stated]
    vertex_normals = vertex_normals / np.maximum(
        np.abs(vertex_normals).max(axis=-1, keepdims=True), 1e-30
    )
    return np.asarray(
        vertex_normals / np.maximum(np.linalg.norm(vertex_normals, axis=-1, keepdims=True), 1e-30)
    )


def _parse(lines: list[str], where: str) -> tuple[Array, Array, Array, Array]:
    """Vertices (V, 3), texture coordinates (T, 2), normals (N, 3), and faces (F, 3, 3).

    faces[f, c] are the indices of corner c into these three. -1 is none; also texture coordinates
    or normals that the file lacks, with a note, since the geometry is complete without.
    """
    tables: dict[str, list[list[float]]] = {"v": [], "vt": [], "vn": []}
    faces: list[list[list[int]]] = []
    for number, line in enumerate(lines, start=1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        try:
            if words[0] in tables:
                count = 2 if words[0] == "vt" else 3
                tables[words[0]].append([float(w) for w in words[1 : 1 + count]])
                if len(tables[words[0]][-1]) != count:
                    raise ValueError("too few numbers")
            elif words[0] == "f":
                ring = [_corner(word, tables) for word in words[1:]]
                if len(ring) < 3:
                    raise ValueError("too few corners")
                faces += [[ring[0], ring[i], ring[i + 1]] for i in range(1, len(ring) - 1)]
        except (ValueError, IndexError) as error:
            raise MatcapError.at(
                where,
                f"line {number} is no valid '{words[0]}'",
                "export the mesh again as OBJ",
            ) from error
    if not faces:
        raise MatcapError.at(where, "there are no faces", "give a Wavefront OBJ file")
    points, spots, normals = (np.array(tables[key], dtype=np.float64) for key in ("v", "vt", "vn"))
    if not np.isfinite(points).all():
        raise MatcapError.at(where, "a vertex is not finite", "export the mesh again")
    indices = np.array(faces, dtype=np.int64)
    for column, (table, what, instead) in _OPTIONAL.items():
        missing = indices[..., column] >= len(tables[table])
        if missing.any():
            note(f"{where}: {int(missing.sum())} corners name {what} it does not hold; {instead}")
            indices[..., column][missing] = -1
    return points, spots, normals, indices


# Indices of a corner that may be missing: table, name, and what takes their place.
_OPTIONAL = {
    1: ("vt", "texture coordinates", "the material lies along x and y"),
    2: ("vn", "normals", "averages of faces are taken there"),
}


def _corner(word: str, tables: dict[str, list[list[float]]]) -> list[int]:
    """Indices of 'v', 'v/vt', 'v//vn' or 'v/vt/vn'; negative ones count from the end."""
    parts = (word.split("/") + ["", ""])[:3]
    indices = []
    for part, (name, table) in zip(parts, tables.items(), strict=True):
        if not part:
            indices.append(-1)
            continue
        index = int(part)
        index = index - 1 if index > 0 else len(table) + index if index < 0 else -1
        if name == "v" and not 0 <= index < len(table):
            raise IndexError(f"there is no element {part}")
        # Texture coordinates and normals may follow later: checked after the last line.
        indices.append(min(index, _NOWHERE) if index >= 0 else _NOWHERE)
    return indices


def _visible(corners: Array, view: View) -> Array:
    """(H, W) index of the nearest front-facing triangle at each pixel's centre, or -1."""
    width, height = view.size
    flat = corners.reshape(-1, 3) - view.position
    right, up, ahead = (flat @ axis for axis in view.axes)
    depth = ahead if view.perspective else np.ones_like(ahead)
    near = ahead.reshape(-1, 3).min(axis=1) > 1e-6
    scale = max(width, height) / 2.0 / view.reach
    with np.errstate(divide="ignore", invalid="ignore"):
        x = (right / depth * scale + width / 2.0 - 0.5).reshape(-1, 3)
        y = (height / 2.0 - 0.5 - up / depth * scale).reshape(-1, 3)
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    kept = np.flatnonzero(near & (area < 0.0))  # front faces: rows run downwards
    low_x = np.clip(np.ceil(x[kept].min(axis=1)), 0, width).astype(np.int64)
    high_x = np.clip(np.floor(x[kept].max(axis=1)), -1, width - 1).astype(np.int64)
    low_y = np.clip(np.ceil(y[kept].min(axis=1)), 0, height).astype(np.int64)
    high_y = np.clip(np.floor(y[kept].max(axis=1)), -1, height - 1).astype(np.int64)
    wide = np.maximum(high_x - low_x + 1, 0)
    counts = wide * np.maximum(high_y - low_y + 1, 0)
    depths = np.full(width * height, np.inf)
    nearest = np.full(width * height, -1, dtype=np.int64)
    ends = np.cumsum(counts)
    start = 0
    while start < len(kept):
        # As many triangles as make _PAIRS, at least one.
        base = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, base + _PAIRS)))
        part = slice(start, stop)
        owner = np.repeat(np.arange(start, stop), counts[part])
        rank = np.arange(len(owner)) - np.repeat(ends[part] - counts[part] - base, counts[part])
        px = low_x[owner] + rank % np.maximum(wide[owner], 1)
        py = low_y[owner] + rank // np.maximum(wide[owner], 1)
        face = kept[owner]
        _nearer(x, y, ahead.reshape(-1, 3), area, face, px, py, width, view, depths, nearest)
        start = stop
    return nearest.reshape(height, width)


def _nearer(
    x: Array,
    y: Array,
    ahead: Array,
    area: Array,
    face: Array,
    px: Array,
    py: Array,
    width: int,
    view: View,
    depths: Array,
    nearest: Array,
) -> None:
    """Depth test: enter pairs of `face` and pixel (px, py) into `depths` and `nearest`.

    x, y, ahead: (F, 3) corners in pixels, and their depths. area: (F,) twice the signed area.
    """

    def edge(i: int, j: int) -> Array:
        covered: Array = (x[face, i] - px) * (y[face, j] - py) - (x[face, j] - px) * (
            y[face, i] - py
        )
        return covered / area[face]

    weights = np.stack([edge(1, 2), edge(2, 0), edge(0, 1)])
    inside = (weights >= -1e-9).all(axis=0)
    face, pixel, weights = face[inside], (py * width + px)[inside], weights[:, inside]
    corner = ahead[face].T
    # In screen space depth is linear (orthographic), or its inverse is (perspective).
    depth = 1.0 / (weights / corner).sum(0) if view.perspective else (weights * corner).sum(0)
    order = np.lexsort((depth, pixel))
    pixel, depth, face = pixel[order], depth[order], face[order]
    first = np.ones(len(pixel), dtype=bool)
    first[1:] = pixel[1:] != pixel[:-1]
    pixel, depth, face = pixel[first], depth[first], face[first]
    closer = depth < depths[pixel]
    depths[pixel[closer]] = depth[closer]
    nearest[pixel[closer]] = face[closer]


def _meet(
    origin: Array, direction: Array, a: Array, b: Array, c: Array
) -> tuple[Array, Array, Array]:
    """Distance and two barycentric coordinates (of b, c) of rays on triangles [moeller1997]."""
    edge1, edge2 = b - a, c - a
    p = np.cross(direction, edge2, axis=0)
    determinant = (edge1 * p).sum(0)
    safe = np.where(np.abs(determinant) > 1e-30, determinant, np.inf)
    s = origin - a
    u = np.clip((s * p).sum(0) / safe, 0.0, 1.0)
    q = np.cross(s, edge1, axis=0)
    v = np.clip((direction * q).sum(0) / safe, 0.0, 1.0 - u)
    return (edge2 * q).sum(0) / safe, u, v


def _aside(normal: Array) -> Array:
    """A unit vector perpendicular to each of (3, ...) unit vectors."""
    x, y, z = normal
    flat = np.where(np.abs(z) < 0.9, np.stack([-y, x, 0 * z]), np.stack([z, 0 * y, -x]))
    return flat / np.maximum(np.sqrt((flat * flat).sum(0)), 1e-12)


# Surfaces of scenes: the plane, and which shape a scene asks for.


@dataclass(frozen=True)
class Flat(Shape):
    """The plane z = 0, `extent` wide and high."""

    extent: tuple[float, float]

    def framed(self, film: Film) -> float:
        """Span of the picture's long side at the origin that shows all of it, plane units."""
        return max(self.extent)

    def hits(self, view: View, top: int, bottom: int) -> Hits:
        """Intersections of the rays of rows [top, bottom) of the picture."""
        if _frontal(view):
            distance = view.position[2] if view.perspective else 1.0
            across, down = view.screen(top, bottom)
            x = across * distance + view.position[0]
            y = down * distance + view.position[1]
            ahead = view.position[2] > 0.0
        else:
            origin, direction = view.rays(top, bottom)
            falling = direction[2] < -1e-9
            along = np.where(falling, -origin[2] / np.where(falling, direction[2], -1.0), -1.0)
            ahead = along > 0.0
            x, y = (np.where(ahead, origin[i] + along * direction[i], 0.0) for i in (0, 1))
        # Pixel centres on the border are inside.
        half_width, half_height = (side / 2.0 * (1.0 + 1e-9) for side in self.extent)
        seen = np.asarray(ahead) & (np.abs(x) <= half_width) & (np.abs(y) <= half_height)
        shape = (bottom - top, view.across[1] - view.across[0])
        point = (x.astype(np.float32), y.astype(np.float32), np.zeros((1, 1), dtype=np.float32))
        to_view, footprint = _seen_from(view, point)
        return Hits(
            point=point,
            frame=None,
            place=(x, y),
            to_view=to_view,
            seen=None if seen.all() else np.broadcast_to(seen, shape),
            footprint=footprint,
        )

    def region(self, view: View, relief: Relief) -> tuple[VisibleRegion, float]:
        """Box around the visible points, and the largest side of a pixel's footprint."""
        high = [side / 2.0 for side in self.extent]
        low = [-side for side in high]
        endless = Flat((math.inf, math.inf))
        rows = [endless.hits(view, row, row + 1) for row in (0, view.size[1] - 1)]
        if all(hits.seen is None for hits in rows):
            # The picture's rays fill a convex part of the plane: its corners bound it.
            for axis in (0, 1):
                places = [float(hits.place[axis].ravel()[i]) for hits in rows for i in (0, -1)]
                slack = 1e-6 * (high[axis] - low[axis])
                low[axis] = min(max(low[axis], min(places) - slack), high[axis])
                high[axis] = max(min(high[axis], max(places) + slack), low[axis])
        region = VisibleRegion((low[0], low[1], relief.low), (high[0], high[1], relief.high), True)
        if view.perspective and not _frontal(view):
            above = view.position[2]
            far = max(
                sum((np.array([x, y, 0.0]) - view.position) ** 2)
                for x in (low[0], high[0])
                for y in (low[1], high[1])
            )
            return region, float(view.pixel * far / above) if above > 0.0 else 0.0
        return region, float(rows[0].footprint.max())


def _seen_from(view: View, point: Vec) -> tuple[Vec, Array]:
    """Unit vectors from points of the plane to the camera, and sides of pixels' footprints."""
    if not view.perspective:
        x, y, z = (np.full((1, 1), c, dtype=np.float32) for c in -view.axes[2])
        return (x, y, z), np.full((1, 1), view.pixel / max(-view.axes[2][2], 1e-6), np.float32)
    offset = subtract(vec(tuple(view.position)), point)
    inverse = 1.0 / np.sqrt(dot(offset, offset))
    to_view = scale(offset, inverse)
    if _frontal(view):
        # The plane is parallel to the picture: one footprint for all pixels.
        return to_view, np.full((1, 1), view.pixel * view.position[2], dtype=np.float32)
    return to_view, view.pixel / inverse / np.maximum(to_view[2], np.float32(1e-6))


def _frontal(view: View) -> bool:
    """Whether the camera looks straight down, with the picture's sides along x and y."""
    return bool(np.abs(view.axes - np.diag([1.0, 1.0, -1.0])).max() < 1e-12)


def shape_of(surface: Surface, texture: Texture) -> Shape:
    """The shape of a surface; reads a mesh's file.

    Raises:
        MatcapError: as load_mesh.
    """
    width, height = (side / surface.repeat for side in texture.extent)
    if surface.type == "plane":
        size = surface.size
        return Flat((width, height) if size is None else (size, size))
    radius = (surface.size or max(width, height)) / 2.0
    if surface.type == "mesh":
        assert surface.file is not None
        return load_mesh(surface.file, 2.0 * radius)
    return Round(radius, surface.type == "cylinder")
