"""Reads and writes OpenEXR files, and reads headers of Radiance HDR."""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.color import REC709, XYZ

# Roles of channels by name, in lower case and without the layer.
_ROLES = {
    **{"r": "R", "red": "R", "g": "G", "green": "G", "b": "B", "blue": "B"},
    **{"a": "A", "alpha": "A"},
}
_COLOURS = ("R", "G", "B")
_GREYS = ("y", "l", "v", "i", "grey", "gray", "luminance", "value", "intensity")
_AXES = {"x": "R", "y": "G", "z": "B"}  # of vectors, as in Blender's normal pass
# Words in names of layers: of the picture itself, and of data that renderers write beside it.
_PICTURE = ("combined", "beauty", "rgba", "rgb", "color", "colour", "main", "default", "composite")
_DATA = frozenset((
    "depth", "z", "zdepth", "ao", "occlusion", "normal", "normals", "n", "position", "p", "uv",
    "mist", "shadow", "vector", "motion", "velocity", "id", "index", "object", "material", "crypto",
    "cryptomatte", "mask", "matte", "albedo", "denoising", "variance", "noisy", "emit", "emission",
    "diffuse", "diff", "glossy", "gloss", "specular", "transmission", "trans", "volume", "direct",
    "indirect", "dir", "ind", "env", "environment", "roughness", "alpha", "opacity", "samples",
    "debug", "aov", "lpe", "facing", "fresnel", "sheen", "coat", "sss", "subsurface",
))  # fmt: skip


@dataclass(frozen=True)
class ExrLayer:
    """A picture in an EXR file."""

    part: int
    """Index of its part."""
    name: str
    """Name of the part and the layer; "" where neither has one."""
    roles: Mapping[str, int]
    """Index of the channel by role "R", "G", "B", "A"; equal for the colours of a grey picture."""

    @property
    def coloured(self) -> bool:
        """Whether it has at least two channels besides alpha."""
        return self.roles["R"] != self.roles.get("G")


def meant_layer(
    specs: Sequence[Any], wanted: Sequence[str] = (), where: str = ""
) -> tuple[ExrLayer, tuple[str, ...]]:
    """The layer that is meant, and a note on which of several it is.

    First is the one that a `wanted` word names, then what is called combined, beauty or the like,
    then the one without a name, other colours, other greys; passes of data come last.

    Args:
        specs: OpenImageIO's specification of each part.
        wanted: words for the data that the file should hold, such as "normal".
        where: the file, for errors.

    Raises:
        MatcapError: no part has a colour or grey channel; luminance and chroma; deep parts alone.
    """
    flat = [(index, spec) for index, spec in enumerate(specs) if not spec.deep]
    layers = [
        layer for index, spec in flat for layer in _layers(index, spec, len(specs) > 1, where)
    ]
    if not layers:
        names = ", ".join(name for spec in specs for name in spec.channelnames)[:80]
        what = f"none of its channels ({names}) is red or grey"
        raise MatcapError.at(where, what, "save it as RGB") if flat else _deep(where)

    def order(layer: ExrLayer) -> tuple[int, int, int]:
        words = re.findall("[a-z]+", re.sub("(?<=[a-z])(?=[A-Z])", " ", layer.name).lower())
        ranks = [wanted.index(word) for word in words if word in wanted]
        if ranks:
            return 0, min(ranks), not layer.coloured
        called = [_PICTURE.index(word) for word in words if word in _PICTURE]
        if _DATA & set(words):
            return 4, 0, not layer.coloured
        if called and layer.coloured:
            return 1, min(called), 0
        return (2 if layer.coloured else 3), bool(layer.name), 0

    chosen = min(layers, key=order)
    if len(layers) == 1:
        return chosen, ()
    names = ", ".join(layer.name or "one without a name" for layer in layers)[:200]
    return chosen, (
        f"The file holds {len(layers)} pictures ({names}): "
        f"{chosen.name or 'the one without a name'} is read.",
    )


def _layers(index: int, spec: Any, several: bool, where: str) -> list[ExrLayer]:  # noqa: ANN401
    """The layers of a part that have a colour or grey channel."""
    part = str(spec.getattribute("oiio:subimagename") or spec.getattribute("name") or "")
    by_name: dict[str, dict[str, int]] = {}
    for place, name in enumerate(spec.channelnames):
        layer, _, tail = name.rpartition(".")
        by_name.setdefault(layer, {}).setdefault(tail.lower(), place)
    if any({"ry", "by"} & set(tails) for tails in by_name.values()):
        raise MatcapError.at(
            where,
            "this EXR file holds luminance and chroma, which is not supported",
            "save it as RGB",
        )
    layers = []
    alone = len(by_name) == 1
    for layer, tails in by_name.items():
        name = f"{part}.{layer}".strip(".") if several else layer
        if (roles := _roles(tails, alone=alone)) is not None:
            layers.append(ExrLayer(index, name, roles))
    return layers


def _roles(tails: Mapping[str, int], *, alone: bool) -> dict[str, int] | None:
    """Index of the channel by role; None where no channel is a colour or grey.

    Args:
        alone: there is no other layer: a single channel of any name is grey.
    """
    known = _ROLES | (_AXES if {"x", "y"} <= set(tails) else {})
    roles = {known[tail]: place for tail, place in tails.items() if tail in known}
    if "R" in roles:
        return roles if "G" in roles else roles | dict.fromkeys(_COLOURS, roles["R"])
    alpha = next((tail for tail in tails if _ROLES.get(tail) == "A"), None)
    others = {tail: place for tail, place in tails.items() if tail != alpha}
    if not others:
        if not alone:
            return None
        others = dict(tails)
    named = [place for tail, place in others.items() if tail in _GREYS]
    if not named and len(others) > 1:
        return None
    grey = (named or list(others.values()))[0]
    return dict.fromkeys(_COLOURS, grey) | ({} if alpha is None else {"A": tails[alpha]})


# Headers of Radiance HDR images: exposure, primaries and orientation [ward1991; larson1998].
#
# Lines of text up to an empty one, then the resolution, such as `-Y 512 +X 1024`: axis and number
# of the scanlines, then axis and number of the texels in each; `-Y` is down, `+X` right. Stored
# radiance is true radiance times the product of all EXPOSURE and COLORCORR entries. FORMAT is RGB
# or CIE XYZ.

MAGIC = b"#?"
_LONGEST = 1 << 16  # bytes of a header
_RESOLUTION = re.compile(rb"([+-])([XY]) +(\d{1,6}) +([+-])([XY]) +(\d{1,6}) *\r?\n")


@dataclass(frozen=True)
class RadianceHeader:
    """A Radiance header."""

    length: int
    """Length of the header in bytes."""
    scanlines: int
    texels: int
    """Number of texels in a scanline."""
    columns: bool
    """Whether scanlines are columns."""
    flips: tuple[bool, bool]
    """Whether y runs up, and x left."""
    exposure: NDArray[np.float64]
    """(3,) stored over true radiance."""
    primaries: tuple[float, ...] | None
    """Primaries as in EXR's chromaticities, or None."""

    def plain(self) -> bytes:
        """A minimal header for the same scanlines, in standard orientation and RGB."""
        size = f"-Y {self.scanlines} +X {self.texels}\n"
        return f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n{size}".encode()

    def upright(self, stored: NDArray[np.float32]) -> NDArray[np.float32]:
        """(H, W, 3) upright true radiance of stored values (scanlines, texels, 3)."""
        picture = stored.transpose(1, 0, 2) if self.columns else stored
        picture = picture[:: -1 if self.flips[0] else 1, :: -1 if self.flips[1] else 1]
        return np.ascontiguousarray(picture / self.exposure.astype(np.float32))


def radiance_header(path: Path) -> RadianceHeader:
    """Read the header of a file that begins with MAGIC.

    Raises:
        ValueError: the header is damaged, or of an unknown format.
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(_LONGEST)
    end = re.search(rb"\n\r?\n", head)
    match = end and _RESOLUTION.match(head, end.end())
    if not end or not match:
        raise ValueError("it has no resolution")
    lines = [line.strip() for line in head[: end.start()].decode("latin-1").split("\n")[1:]]
    entries = [line.split("=", 1) for line in lines if "=" in line]
    formats = [value.strip() for key, value in entries if key.strip() == "FORMAT"]
    xyz = any(value == "32-bit_rle_xyze" for value in formats)
    if not xyz and any(value != "32-bit_rle_rgbe" for value in formats):
        raise ValueError(f"its format is {formats[0][:40]!r}")
    exposure = np.ones(3)
    primaries: tuple[float, ...] | None = XYZ if xyz else None
    for key, value in entries:
        numbers = [float(word) for word in value.split()] if key in _NUMBERS else []
        if len(numbers) != _NUMBERS.get(key, 0):
            raise ValueError(f"its {key} is {value[:40]!r}")
        if key == "PRIMARIES":
            primaries = tuple(numbers)
        elif numbers:
            exposure = exposure * numbers
    if not (np.isfinite(exposure).all() and exposure.min() > 0.0):
        raise ValueError("its exposure is none")
    (first, axis, scanlines), (second, other, texels) = match.groups()[:3], match.groups()[3:]
    if axis == other or not int(scanlines) or not int(texels):
        raise ValueError("its resolution is none")
    signs = {axis: first, other: second}
    flips = signs[b"Y"] == b"+", signs[b"X"] == b"-"
    return RadianceHeader(
        match.end(), int(scanlines), int(texels), axis == b"X", flips, exposure, primaries
    )


_NUMBERS = {"EXPOSURE": 1, "COLORCORR": 3, "PRIMARIES": 8}

# Reads and writes OpenEXR files: single-part scanlines, ZIP, Rec.709.
#
# Written with OpenEXR, which stores no date, so that equal arrays give equal files. Read with
# OpenImageIO, which returns errors, where OpenEXR prints them. Tiled files: synth/pictures.py.

LARGEST_HALF = 65504.0  # of half float (IEEE 754)


def write_exr(path: Path, pixels: NDArray[np.float32], *, half: bool) -> None:
    """Write (H, W, 3) as channels R, G, B or (H, W) as channel Y, as half floats or float32.

    Not atomic: write into an Output's stage.

    Raises:
        MatcapError: a value is not finite, or too large for half float.
        OSError: the file cannot be written.
    """
    channels = {"RGB" if pixels.ndim == 3 else "Y": pixels}
    write_exr_channels(path, channels, half=half, chromaticities=REC709)


def check_representable(name: str, pixels: NDArray[np.float32], *, half: bool) -> None:
    """Raise MatcapError for values that the file cannot represent."""
    if not np.isfinite(pixels).all():
        raise MatcapError.at(name, "has values that are not finite", "make the maps again")
    if half and np.abs(pixels).max(initial=0.0) > LARGEST_HALF:
        raise MatcapError.at(name, "has values too large for half float (65504)", "scale them down")


def write_exr_channels(
    path: Path, channels: Mapping[str, NDArray[np.float32]], *, half: bool = True, **more: object
) -> None:
    """Write planes (H, W) by channel name, with `more` entries of the header; see write_exr()."""
    import OpenEXR

    stored = {}
    for name, pixels in channels.items():
        check_representable(path.name, pixels, half=half)
        stored[name] = np.ascontiguousarray(pixels, dtype=np.float16 if half else np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **more}
    try:
        OpenEXR.File(header, stored).write(str(path))
    except RuntimeError as error:
        # OpenEXR reports the cause in the text only.
        full = "No space left" in str(error)
        raise OSError(errno.ENOSPC if full else errno.EIO, str(error)) from error


@dataclass(frozen=True)
class NamedChannels:
    """Content of an EXR file."""

    pixels: NDArray[np.float32]
    """(H, W, C) values of the channels."""
    names: tuple[str, ...]
    primaries: tuple[float, ...] | None
    """Chromaticities x, y of red, green, blue and white, or None."""


def read_exr(
    path: Path, *, size: tuple[int, int] | None = None, channels: Sequence[str] | None = None
) -> NamedChannels:
    """Read an EXR file.

    Args:
        size: expected (width, height); checked before any pixel is read.
        channels: names to read, in this order; None is all, in the file's order.

    Raises:
        MatcapError: missing, not an EXR file, truncated, corrupt, of another size, without a
            channel, or with values that are not finite.
    """
    import OpenImageIO as oiio

    remedy = "write the map set again"
    if not os.path.isfile(path):  # also False for invalid names
        raise MatcapError.at(path, "the file is missing", remedy)
    source = oiio.ImageInput.open(str(path))
    if source is None:
        forget_error(oiio.geterror)
        raise MatcapError.at(path, "this is not a readable EXR file", remedy)
    try:
        spec = source.spec()
        if spec.deep:
            raise _deep(path)
        actual = (spec.width, spec.height)
        if size is not None and actual != size:
            raise MatcapError.at(
                path, f"is {actual[0]} x {actual[1]} texels, not {size[0]} x {size[1]}", remedy
            )
        missing = [name for name in channels or () if name not in spec.channelnames]
        if missing:
            raise MatcapError.at(path, f"has no channel {', '.join(missing)}", remedy)
        pixels = source.read_image("float")
        forget_error(source.geterror)
    except MemoryError as error:
        raise MatcapError.at(
            path, "there is not enough memory to read it", "free some memory, or write smaller maps"
        ) from error
    finally:
        source.close()
    if pixels is None:
        raise MatcapError.at(path, "the file is truncated or corrupt", remedy)
    if not np.isfinite(pixels).all():
        raise MatcapError.at(path, "has values that are not finite", remedy)
    names = tuple(channels or spec.channelnames)
    pixels = pixels[..., [spec.channelnames.index(name) for name in names]]
    return NamedChannels(np.asarray(pixels, dtype=np.float32), names, stated_primaries(spec))


def _deep(where: object) -> MatcapError:
    """The error for a deep EXR file."""
    return MatcapError.at(
        where,
        "this is a deep EXR file, which is not supported",
        "flatten it, and save it with one sample a pixel",
    )


def stated_primaries(spec: Any) -> tuple[float, ...] | None:  # noqa: ANN401
    """Chromaticities x, y of red, green, blue and white that an EXR file states, or None."""
    stated = spec.getattribute("chromaticities")
    return None if stated is None else tuple(float(value) for value in stated)


def forget_error(fetch: Callable[[], object]) -> str:
    """Fetch OpenImageIO's pending error, which it would otherwise print at exit; "" if none."""
    with suppress(UnicodeDecodeError):
        return str(fetch())
    return "an error that is no text"  # it may quote the file's bytes
