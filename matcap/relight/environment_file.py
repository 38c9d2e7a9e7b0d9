"""Pictures of surroundings: latitude by longitude in EXR or Radiance HDR, or cube maps in EXR.

Linear Rec.709 radiance, whatever primaries the file states. What lies outside of an EXR file's data
window is black. A cube map is one that says so (OpenEXR's envmap); it is looked up by
latitude and longitude. A picture of code values (PNG, JPEG) is decoded by its curve, with a note.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.note import note
from matcap.files.pixels import linear_colours, read_pixels
from matcap.relight.brightness import BRIGHTEST

_REMEDY = "give a latitude-longitude EXR or HDR picture"
_CUBE = "CubeFace Environment"
_SHAPE = 0.05  # by which a picture's sides may be off 2 : 1
_DARK = 0.5  # of all light: what is below zero by more is no radiance
_SMALLEST = 4  # pixels a side below which a picture's shape says nothing

EnvironmentPicture = NDArray[np.float32]


def read_picture(path: Path) -> EnvironmentPicture:
    """(H, W, 3) linear radiance by latitude (top: +y) and longitude (middle: +z, right: -x).

    Raises:
        MatcapError: missing, unreadable, of another projection, not finite, mostly negative, or too
            bright.
    """
    where = str(path)
    if not path.is_file():
        raise MatcapError("no such file", where=where, remedy="check the path")
    pixels = read_pixels(path, outside=0.0)
    picture, notes = linear_colours(pixels)
    for sentence in notes:
        note(f"{where}: {sentence}")
    if pixels.whole:
        note(f"{where}: code values, not light: decoded, and nothing is brighter than white (1.0)")
    if pixels.partial:
        note(f"{where}: the file holds a part of its picture (its data window); the rest is black")
    picture = _radiance(np.asarray(picture, np.float32), where)
    if pixels.surroundings == _CUBE:
        return _from_cube(picture, where)
    height, width = picture.shape[:2]
    if max(width, height) > _SMALLEST and abs(width / (2.0 * height) - 1.0) > _SHAPE:
        raise MatcapError(
            f"is {width} x {height} pixels{_looks_like(width, height)}, and a latitude-longitude "
            "picture is twice as wide as high",
            where=where,
            remedy=_REMEDY,
        )
    return picture


def _radiance(picture: EnvironmentPicture, where: str) -> EnvironmentPicture:
    """What light there is: a little below zero is rounding, or a colour outside of Rec.709."""
    if picture.max() > BRIGHTEST:
        raise MatcapError(
            f"has a value of {picture.max():.2g}, too bright for single precision",
            where=where,
            remedy="clip its brightest pixels in a picture editor",
        )
    below = picture < 0.0
    if not below.any():
        return picture
    dark, light = (float(np.abs(picture[part]).sum(dtype=np.float64)) for part in (below, ~below))
    if dark > _DARK * light:
        raise MatcapError("has values that are no radiance", where=where, remedy=_REMEDY)
    pixels = int(below.any(axis=2).sum())
    note(f"{where}: {pixels} pixels reach down to {picture.min():.3g} and are taken as 0 there")
    return np.maximum(picture, np.float32(0.0))


def _looks_like(width: int, height: int) -> str:
    """A word on what a shape is usual for."""
    ratio = width / height
    for usual, what in (
        (1.0, ", as a mirror ball or an angular map"),
        (4.0 / 3.0, ", as a cube map's cross"),
        (0.75, ", as a cube map's cross"),
        (6.0, ", as a cube map's strip"),
        (1.0 / 6.0, ", as a cube map's strip"),
    ):
        if abs(ratio / usual - 1.0) < 0.01:
            return what
    return ""


def _from_cube(cube: EnvironmentPicture, where: str) -> EnvironmentPicture:
    """(2 n, 4 n, 3) by latitude and longitude, of six faces of n pixels one below the other.

    OpenEXR's ImfEnvmap: +X, -X, +Y, -Y, +Z, -Z; pixels at a face's border lie on the cube's edge.
    """
    import cv2

    side = cube.shape[1]
    if side < 2 or cube.shape[0] != 6 * side:
        raise MatcapError(
            f"calls itself a cube map and is {side} x {cube.shape[0]} pixels, not 1 : 6",
            where=where,
            remedy=_REMEDY,
        )
    polar = ((np.arange(2 * side) + 0.5) * math.pi / (2 * side))[:, None]
    azimuth = (((np.arange(4 * side) + 0.5) / (4 * side) - 0.5) * 2.0 * math.pi)[None, :]
    x, y = -np.sin(azimuth) * np.sin(polar), np.cos(polar) + 0.0 * azimuth
    z = np.cos(azimuth) * np.sin(polar)
    ax, ay, az = np.abs(x), np.abs(y), np.abs(z)
    on_x, on_y = (ax >= ay) & (ax >= az), (ay >= az) & ~((ax >= ay) & (ax >= az))
    # Of each face: where it is looked at, and the pixel's column and row in [-1, 1] on it.
    faces = (
        (on_x & (x > 0.0), z, -y, ax),
        (on_x & (x <= 0.0), -z, -y, ax),
        (on_y & (y > 0.0), x, -z, ay),
        (on_y & (y <= 0.0), x, z, ay),
        (~on_x & ~on_y & (z > 0.0), -x, -y, az),
        (~on_x & ~on_y & (z <= 0.0), x, -y, az),
    )
    picture = np.zeros((2 * side, 4 * side, 3), np.float32)
    for index, (seen, column, row, far) in enumerate(faces):
        face = np.ascontiguousarray(cube[index * side : (index + 1) * side])
        at = [((one / far + 1.0) * (0.5 * (side - 1))).astype(np.float32) for one in (column, row)]
        looked_up = cv2.remap(face, at[0], at[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        picture[seen] = looked_up[seen]
    return picture
