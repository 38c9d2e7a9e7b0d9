"""The colour space that an image file states: ICC profile, code points or Exif."""

from __future__ import annotations

import io
import struct
import warnings
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.files import containers
from matcap.files.color import (
    ADOBE_RGB,
    LINEAR,
    REC709,
    REC709_TO_D50,
    SRGB,
    XYZ,
    ColorSpace,
    Curve,
    Linearise,
    Values,
    assumed,
    converted,
    largest_code,
    linear,
    power,
    space_of_code_points,
    space_of_primaries,
    srgb_decode,
)
from matcap.files.containers import FileKind, Tag

# ICC profiles: conversion of a file's colours to linear Rec.709 (ICC.1:2022).
#
# Matrix profiles (Display P3, Adobe RGB, ProPhoto, those of cameras and phones) are evaluated in
# floating point; an 8-bit colour engine would clip colours outside sRGB and quantise shadows.
# Profiles of lookup tables are evaluated by Pillow's ImageCms, at 8 bits.

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
    if profile[16:20] not in _MODES:
        return None
    tags, grey = _tags(profile), profile[16:20] == b"GRAY"
    if not grey and len(tags.get(b"cicp", b"")) >= 12:  # ICC.1:2022, 9.2.17
        stated = space_of_code_points(tags[b"cicp"][8], tags[b"cicp"][9])
        if stated is not None:
            return stated
    curves, colorants = ((b"kTRC",) * 3, ()) if grey else (_CURVES, _COLORANTS)
    if profile[20:24] != b"XYZ " or any(name not in tags for name in (*curves, *colorants)):
        return None
    red, green, blue = (_checked(_curve(tags[name])) for name in curves)
    if grey:  # whose curve is to luminance
        return ColorSpace(_description(tags), (red, green, blue))
    xyz = [np.array(struct.unpack_from(">3i", tags[name], 8)) / 65536.0 for name in colorants]
    matrix = np.linalg.solve(REC709_TO_D50, np.stack(xyz, axis=1))
    # Equal code values stay grey, whatever the rounding of the colorants.
    matrix /= matrix.sum(axis=1, keepdims=True)
    if not np.isfinite(matrix).all():
        raise ValueError("the colorants are no basis")
    same = bool(np.abs(matrix - np.eye(3)).max() < 2e-3)
    return ColorSpace(_description(tags), (red, green, blue), None if same else matrix)


def _tags(profile: bytes) -> dict[bytes, bytes]:
    (count,) = struct.unpack_from(">I", profile, 128)
    if count > 200:
        raise ValueError("too many tags")
    table = [struct.unpack_from(">4sII", profile, 132 + 12 * i) for i in range(count)]
    return {name: profile[offset : offset + size] for name, offset, size in table}


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
    scale = 255.0 / largest_code(dtype)

    def linearise(rows: NDArray[np.generic]) -> NDArray[np.float32]:
        codes = (rows if mode != "L" else rows[..., 0]).astype(np.float32) * scale
        strip = Image.fromarray(np.ascontiguousarray(np.rint(codes.clip(0, 255)), np.uint8))
        return decode(np.asarray(ImageCms.applyTransform(strip, transform)))

    return linearise


# The colour space that an image file states: by ICC profile, code points, Exif or chunks.
#
# | format | stated by, the first that is present |
# | --- | --- |
# | PNG | cICP, iCCP, sRGB, gAMA with cHRM (PNG 3rd edition, 11.3.2) |
# | JPEG | ICC profile; Exif's InteroperabilityIndex R03, Adobe RGB (DCF 2.0) |
# | TIFF | ICC profile; R03; WhitePoint with PrimaryChromaticities (TIFF 6.0, section 20) |
# | WebP | ICC profile |
# | HEIC, AVIF | ICC profile; nclx (ISO/IEC 23008-12) |
#
# Files without a statement are sRGB. A statement that cannot be read gives a note. EXR files state
# primaries (rec709.rec709_from).

_MOST_CHUNK = 1 << 26  # bytes; larger chunks are skipped, as a header may claim any size
_UNCALIBRATED = 65535
_DECODED = 1 << 24  # most bytes of a decompressed profile


@dataclass(frozen=True)
class StatedColor:
    """Colour space that a file states."""

    profile: bytes | None = None
    """ICC profile, which has precedence over `space`, or None."""
    space: ColorSpace = SRGB
    """Colour space by other metadata; sRGB without any."""
    notes: tuple[str, ...] = ()
    """Notes to the user."""

    def lineariser(self, dtype: np.dtype[Any]) -> tuple[Linearise, tuple[str, ...]]:
        """A function from code values (n, W, 3) to linear Rec.709, and notes to the user."""
        linearise, notes = lineariser_of(self.profile, dtype, self.space)
        return linearise, self.notes + notes


def stated_color(path: Path, page: int = 0) -> StatedColor:
    """Read the statement of a PNG, JPEG, TIFF, WebP, HEIC or AVIF file; others are sRGB.

    A damaged statement gives a note.

    Args:
        page: index of the picture in a TIFF file.

    Raises:
        MatcapError: the file cannot be read.
    """
    head = containers.read_head(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about malformed tags
            return _stated(path, head, page)
    except Exception:  # parsers raise anything on damaged data, OSError too
        return StatedColor(notes=(assumed(SRGB, "statement of its colours"),))


def _stated(path: Path, head: bytes, page: int) -> StatedColor:
    kind = containers.kind_of(head)
    if kind is FileKind.PNG:
        return _of_png(dict(png_chunks(path)))
    if kind in (FileKind.JPEG, FileKind.WEBP):
        info = containers.pillow_info(path, kind)
        if "icc_profile" in info:  # None where one of its parts is missing
            return StatedColor(info["icc_profile"] or b"incomplete")
        exif = info.get("exif") if kind is FileKind.JPEG else None
        return _of_exif(exif) if exif else StatedColor()
    if kind is FileKind.TIFF:
        return _of_tiff(path, page)
    if kind not in (FileKind.HEIC, FileKind.AVIF):
        return StatedColor()
    properties = containers.primary_properties(path)
    if properties.profile is not None or properties.code_points is None:
        return StatedColor(properties.profile)
    return _of_code_points(*properties.code_points, "nclx")


def png_chunks(path: Path) -> Iterator[tuple[bytes, bytes]]:
    """(type, data) of a PNG's chunks except image data, up to where the file is truncated."""
    with path.open("rb") as file:
        file.seek(8)
        while len(head := file.read(8)) == 8:
            (size,) = struct.unpack(">I", head[:4])
            if head[4:] in (b"IDAT", b"fdAT") or size > _MOST_CHUNK:
                file.seek(size + 4, 1)
                continue
            data = file.read(size)
            if len(data) < size or head[4:] == b"IEND":
                return
            file.seek(4, 1)
            yield head[4:], data


def _of_png(chunks: dict[bytes, bytes]) -> StatedColor:
    """The statement of a PNG's chunks."""
    if len(chunks.get(b"cICP", b"")) >= 2:
        return _of_code_points(chunks[b"cICP"][0], chunks[b"cICP"][1], "cICP")
    if b"iCCP" in chunks:
        return StatedColor(_inflated(chunks[b"iCCP"]))
    if b"sRGB" in chunks or not {b"gAMA", b"cHRM"} & chunks.keys():
        return StatedColor()
    try:
        return _of_gamma(chunks.get(b"gAMA"), chunks.get(b"cHRM"))
    except (ValueError, struct.error, ZeroDivisionError):
        return StatedColor(notes=(assumed(SRGB, "gAMA and cHRM"),))


def _of_exif(exif: bytes) -> StatedColor:
    """The statement of Exif: R03 is Adobe RGB (DCF 2.0); an uncalibrated space gives a note."""
    from PIL import Image

    tags = Image.Exif()
    tags.load(exif)
    index = tags.get_ifd(Tag.InteroperabilityIFD).get(1, "")
    stated = tags.get_ifd(Tag.ExifIFD).get(Tag.ColorSpace, 1)
    if str(index).startswith("R03") and stated != 1 or stated == 2:  # 2: what some cameras write
        return StatedColor(space=ADOBE_RGB, notes=converted(ADOBE_RGB))
    if stated == _UNCALIBRATED:
        says = "The file calls its colours uncalibrated and has no profile: sRGB assumed."
        return StatedColor(notes=(says,))
    return StatedColor()


def _of_code_points(primaries: int, transfer: int, name: str) -> StatedColor:
    space = space_of_code_points(primaries, transfer)
    if space is None:
        what = f"colour space ({name}: primaries {primaries}, transfer {transfer})"
        return StatedColor(notes=(assumed(SRGB, what),))
    return StatedColor(space=space, notes=converted(space))


def _of_gamma(gamma: bytes | None, corners: bytes | None) -> StatedColor:
    """The statement of gAMA and cHRM; 0.45455 with sRGB's primaries, or none, means sRGB."""
    primaries = None
    if corners is not None:
        white_x, white_y, *rest = (v / 100_000.0 for v in struct.unpack(">8I", corners))
        primaries = (*rest, white_x, white_y)
    exponent = None if gamma is None else 100_000.0 / struct.unpack(">I", gamma)[0]
    usual = exponent is None or abs(exponent - 2.2) < 0.01
    if exponent is not None and not 0.1 < exponent < 10.0:
        raise ValueError("an exponent that no picture has")
    flat = exponent is not None and abs(exponent - 1.0) < 1e-3
    curve = linear if flat else power(exponent or 2.2)
    parts = [] if exponent is None else [f"gamma {exponent:.3g}"]
    parts += ["primaries"] if primaries is not None else []
    space = space_of_primaries(primaries, curve, " and ".join(parts))
    if usual and space.matrix is None:
        return StatedColor()
    if exponent is None:
        space = ColorSpace("primaries", SRGB.curves, space.matrix)
    return StatedColor(space=space, notes=converted(space))


def _inflated(chunk: bytes) -> bytes:
    """The profile of an iCCP chunk: a name, a zero, the method 0, deflated bytes."""
    start = chunk.index(b"\0") + 2
    return zlib.decompressobj().decompress(chunk[start:], _DECODED)


def _of_tiff(path: Path, page: int) -> StatedColor:
    import tifffile

    with tifffile.TiffFile(path) as file:
        chosen: Any = file.pages.get(page)
        tags = chosen.tags
        if Tag.InterColorProfile in tags:
            return StatedColor(bytes(tags[Tag.InterColorProfile].value))
        stated = tuple(
            tags[t].value if t in tags else () for t in (Tag.PrimaryChromaticities, Tag.WhitePoint)
        )
    corners, white = (np.ravel(values).astype(np.float64) for values in stated)
    if len(corners) == 12 and len(white) == 4:
        primaries = np.concatenate([corners, white]).reshape(-1, 2)
        space = space_of_primaries(
            (primaries[:, 0] / primaries[:, 1]).tolist(), SRGB.curves[0], "primaries"
        )
        if space.matrix is not None:
            return StatedColor(space=space, notes=converted(space))
    return StatedColor()


# Colour spaces by name: the Color Interop Forum's IDs, which EXR's colorInteropID holds
# (OpenEXR 3.4), as CURVE_PRIMARIES or CURVE_PRIMARIES_STATE.

_ACES_WHITE = (0.32168, 0.33767)
_D65 = (0.3127, 0.3290)
_NAMED_PRIMARIES: dict[str, tuple[float, ...]] = {
    "rec709": REC709,
    "ap1": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, *_ACES_WHITE),
    "ap0": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, *_ACES_WHITE),
    "p3d65": (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *_D65),
    "rec2020": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *_D65),
    "adobergb": (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, *_D65),
    "ciexyzd65": XYZ,
}
_NAMED_CURVES: dict[str, Curve] = {
    "lin": linear,
    "srgb": srgb_decode,
    **{f"g{tenths}": power(tenths / 10.0) for tenths in (18, 22, 24, 26)},
}


def space_of_name(name: str) -> ColorSpace | None:
    """The colour space of an ID such as lin_ap1_scene or srgb_rec709; None if it is unknown."""
    curve, _, rest = name.strip().lower().partition("_")
    primaries = rest.partition("_")[0]
    if curve not in _NAMED_CURVES or primaries not in _NAMED_PRIMARIES:
        return None
    if primaries == "rec709" and curve in ("lin", "srgb"):
        return LINEAR if curve == "lin" else SRGB
    return space_of_primaries(_NAMED_PRIMARIES[primaries], _NAMED_CURVES[curve], name.strip()[:40])
