"""ICC profiles: conversion of a file's colours to linear Rec.709 (ICC.1:2022).

Matrix profiles (Display P3, Adobe RGB, ProPhoto, those of cameras and phones) are evaluated in
floating point; an 8-bit colour engine would clip colours outside sRGB and quantise shadows.
Profiles of lookup tables are evaluated by Pillow's ImageCms, at 8 bits.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from matcap.files.color import (
    REC709_TO_D50,
    SRGB,
    ColorSpace,
    Curve,
    Linearise,
    Values,
    assumed,
    largest_code,
    power,
    space_of_code_points,
)
from matcap.files.srgb import srgb_decode

_COLORANTS = (b"rXYZ", b"gXYZ", b"bXYZ")
_CURVES = (b"rTRC", b"gTRC", b"bTRC")
# Number of parameters of each type of parametric curve, table 68.
_PARAMETERS = (1, 3, 4, 5, 7)
# Pillow's mode by a profile's colour space signature.
_MODES = {b"RGB ": "RGB", b"GRAY": "L"}


def lineariser_of(
    profile: bytes | None, dtype: np.dtype[np.generic], default: ColorSpace
) -> tuple[Linearise, tuple[str, ...]]:
    """A function from code values (n, W, 3) to linear Rec.709, and notes to the user.

    Args:
        profile: the ICC bytes, or None.
        default: the colour space without a profile, or with one that cannot be used.
    """
    if not profile:
        return default.lineariser(dtype), ()
    try:
        space = read_profile(profile)
    except (ValueError, struct.error, IndexError):
        space = None  # LittleCMS may read it
    if space is not None:
        note = f"Colours converted from the file's profile ({space.name}) to Rec.709."
        return space.lineariser(dtype), () if _is_srgb(space) else (note,)
    managed = _managed(profile, dtype)
    if managed is not None:
        return managed, ("Colours converted through the file's profile at 8 bits.",)
    return default.lineariser(dtype), (assumed(default, "colour profile"),)


def _is_srgb(space: ColorSpace) -> bool:
    """Whether a colour space is sRGB within the differences between sRGB profiles."""
    codes = np.linspace(0.0, 1.0, 64)
    worst = max(float(np.abs(curve(codes) - srgb_decode(codes)).max()) for curve in space.curves)
    return space.matrix is None and space.system_gamma == 1.0 and worst < 2e-3


def read_profile(profile: bytes) -> ColorSpace | None:
    """The colour space of a profile by code points, matrix or grey curve; None for others.

    Raises:
        ValueError, struct.error, IndexError: the profile is damaged.
    """
    if profile[16:20] == b"GRAY":
        return _grey(profile)
    if profile[16:20] != b"RGB ":
        return None
    tags = _tags(profile)
    if len(tags.get(b"cicp", b"")) >= 12:  # ICC.1:2022, 9.2.17
        stated = space_of_code_points(tags[b"cicp"][8], tags[b"cicp"][9])
        if stated is not None:
            return stated
    if profile[20:24] != b"XYZ " or any(name not in tags for name in _COLORANTS + _CURVES):
        return None
    red, green, blue = (_checked(_curve(tags[name])) for name in _CURVES)
    colorants = np.stack([_xyz(tags[name]) for name in _COLORANTS], axis=1)
    matrix = np.linalg.solve(REC709_TO_D50, colorants)
    # Equal code values stay grey, whatever the rounding of the colorants.
    matrix /= matrix.sum(axis=1, keepdims=True)
    if not np.isfinite(matrix).all():
        raise ValueError("the colorants are no basis")
    same = bool(np.abs(matrix - np.eye(3)).max() < 2e-3)
    return ColorSpace(_description(tags), (red, green, blue), None if same else matrix)


def _grey(profile: bytes) -> ColorSpace | None:
    """The colour space of a grey profile, whose curve is to luminance."""
    tags = _tags(profile)
    if b"kTRC" not in tags or profile[20:24] != b"XYZ ":
        return None
    return ColorSpace(_description(tags), (_checked(_curve(tags[b"kTRC"])),) * 3)


def _tags(profile: bytes) -> dict[bytes, bytes]:
    (count,) = struct.unpack_from(">I", profile, 128)
    if count > 200:
        raise ValueError("too many tags")
    table = [struct.unpack_from(">4sII", profile, 132 + 12 * i) for i in range(count)]
    return {name: profile[offset : offset + size] for name, offset, size in table}


def _xyz(tag: bytes) -> Values:
    return np.array(struct.unpack_from(">3i", tag, 8)) / 65536.0


def _curve(tag: bytes) -> Curve:
    if tag[:4] == b"para":
        return _parametric(tag)
    if tag[:4] != b"curv":
        raise ValueError("not a curve")
    (count,) = struct.unpack_from(">I", tag, 8)
    if count == 0:
        return power(1.0)
    if count == 1:
        return power(struct.unpack_from(">H", tag, 12)[0] / 256.0)
    points = np.frombuffer(tag, ">u2", count, 12) / 65535.0
    return lambda code: np.interp(code, np.linspace(0.0, 1.0, count), points)


def _checked(curve: Curve) -> Curve:
    with np.errstate(all="ignore"):
        light = curve(np.linspace(0.0, 1.0, 256))
    if not (np.isfinite(light).all() and light.min() > -0.1 and light.max() < 1.1):
        raise ValueError("a curve leaves the range of light")
    return curve


def _parametric(tag: bytes) -> Curve:
    (kind,) = struct.unpack_from(">H", tag, 8)
    if kind >= len(_PARAMETERS):
        raise ValueError("an unknown curve")
    values = [v / 65536.0 for v in struct.unpack_from(f">{_PARAMETERS[kind]}i", tag, 12)]
    gamma, a, b, c, d, e, f = _full_parameters(kind, values)

    def evaluate(code: Values) -> Values:
        above = np.maximum(a * code + b, 0.0) ** gamma + e
        return np.where(code >= d, above, c * code + f)

    return evaluate


def _full_parameters(kind: int, values: list[float]) -> tuple[float, ...]:
    """Types 0 to 4 as (g, a, b, c, d, e, f): (a x + b)^g + e from d on, c x + f below."""
    if kind == 0:
        return (values[0], 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if kind >= 3:
        return (*values, 0.0, 0.0)[:7]
    gamma, a, b, floor = (*values, 0.0)[:4]
    return (gamma, a, b, 0.0, -b / a if a else 0.0, floor, floor)


def _description(tags: dict[bytes, bytes]) -> str:
    tag = tags.get(b"desc", b"")
    if tag[:4] == b"mluc" and len(tag) >= 28:
        size, offset = struct.unpack_from(">II", tag, 20)
        text = tag[offset : offset + size].decode("utf-16-be", "ignore")
    else:
        size = struct.unpack_from(">I", tag, 8)[0] if len(tag) >= 12 else 0
        text = tag[12 : 12 + size].decode("ascii", "ignore")
    return "".join(c for c in text if c.isprintable()).strip()[:60] or "unnamed"


def _managed(profile: bytes, dtype: np.dtype[np.generic]) -> Linearise | None:
    """A lineariser through Pillow's ImageCms, for profiles made of tables."""
    from PIL import Image, ImageCms

    mode = _MODES.get(profile[16:20])
    if mode is None:
        return None
    try:
        source = ImageCms.getOpenProfile(io.BytesIO(profile))
        transform = ImageCms.buildTransform(
            source,
            ImageCms.createProfile("sRGB"),
            mode,
            "RGB",
            ImageCms.Intent.RELATIVE_COLORIMETRIC,  # the perceptual one moves the shadows
        )
    except (ImageCms.PyCMSError, OSError, ValueError):
        return None
    decode = SRGB.lineariser(np.dtype(np.uint8))
    to_8_bits = _to_8_bits(dtype)

    def linearise(rows: NDArray[np.generic]) -> NDArray[np.float32]:
        codes = to_8_bits(rows if mode != "L" else rows[..., 0])
        strip = Image.fromarray(np.ascontiguousarray(codes))
        converted = ImageCms.applyTransform(strip, transform)
        return decode(np.asarray(converted))

    return linearise


def _to_8_bits(
    dtype: np.dtype[np.generic],
) -> Callable[[NDArray[np.generic]], NDArray[np.uint8]]:
    scale = 255.0 / largest_code(dtype)
    return lambda rows: np.rint(np.clip(rows.astype(np.float32) * scale, 0, 255)).astype(np.uint8)
