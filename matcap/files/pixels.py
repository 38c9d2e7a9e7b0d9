"""Reads the stored values of images: EXR, TIFF, PNG, JPEG, TGA, BMP, WebP, Radiance HDR.

Values are not converted, and alpha is not premultiplied. Pillow decodes JPEG, because it reports
truncated files; OpenImageIO decodes the rest. linear_colours() converts by the file's colour space
(stated_color.py). Photographs are read strip by strip in matcap/photo.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.color import LINEAR
from matcap.files.exr import forget_error, refuse_deep, stated_primaries
from matcap.files.icc import lineariser_of
from matcap.files.jpeg_coding import unsupported_jpeg
from matcap.files.quiet import quiet_decoders
from matcap.files.radiance import MAGIC, radiance_header
from matcap.files.rec709 import rec709_from
from matcap.files.stated_color import stated_color

MOST_PIXELS = 2**28  # 16384 x 16384; a header may claim any size
_RGB = {"R": 0, "G": 1, "B": 2}
# Roles of channels by name, in lower case and without the layer.
_ROLES = {
    **{"r": "R", "red": "R", "g": "G", "green": "G", "b": "B", "blue": "B"},
    **{"a": "A", "alpha": "A"},
}
_GREYS = ("y", "l", "v", "i", "grey", "gray", "luminance", "value", "intensity")
_AXES = {"x": "R", "y": "G", "z": "B"}  # of vectors, as in Blender's normal pass
_NOT_BUILT = "not configured"  # in libtiff's error for a compression that it was built without
_NO_COLOURS = ("CMYK", "CIELAB", "YCCK")  # colour spaces that the decoders do not convert


@dataclass(frozen=True)
class Pixels:
    """Stored values of an image."""

    path: Path
    """Path of the file."""
    stored: NDArray[Any]
    """(H, W, C) uint8, uint16 or float32."""
    roles: Mapping[str, int]
    """Index of the channel by role "R", "G", "B", "A"; equal for the colours of a grey image."""
    primaries: tuple[float, ...] | None = None
    """Chromaticities x, y of red, green, blue and white of an EXR file, or None."""
    surroundings: str = ""
    """An EXR file's `textureformat`, which names the projection of an environment map; or ""."""
    partial: bool = False
    """Whether an EXR file's data window is smaller than its display window."""

    @property
    def size(self) -> tuple[int, int]:
        """(width, height)."""
        return self.stored.shape[1], self.stored.shape[0]

    @property
    def whole(self) -> bool:
        """Whether the values are integers, that is code values."""
        return bool(np.issubdtype(self.stored.dtype, np.integer))

    @property
    def grey(self) -> bool:
        """Whether there is one channel besides alpha."""
        return self.roles["R"] == self.roles.get("G")

    def channel(self, role: str) -> NDArray[np.float32]:
        """(H, W) float32 channel of a role; integers are divided by their type's maximum.

        Raises:
            KeyError: there is no such channel.
        """
        plane = self.stored[..., self.roles[role]]
        if not self.whole:
            return np.ascontiguousarray(plane, np.float32)
        return plane.astype(np.float32) / np.float32(np.iinfo(plane.dtype).max)

    def colours(self) -> NDArray[Any]:
        """(H, W, 3) stored colours; grey is repeated.

        Raises:
            KeyError: a colour is missing.
        """
        places = [self.roles[role] for role in _RGB]
        return np.ascontiguousarray(self.stored[..., places])


def read_pixels(path: Path, *, outside: float | None = None) -> Pixels:
    """Read an image; of an EXR file the display window.

    Args:
        outside: value of the display window beyond the data window; None refuses such files.

    Raises:
        MatcapError: missing, not an image, truncated, too large, of an unsupported kind, with
            values that are not finite, or without a colour or grey channel.
    """
    where = str(path)
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except (OSError, ValueError) as error:  # ValueError: a name with a null character
        missing = isinstance(error, FileNotFoundError)
        raise MatcapError.at(
            where, "the file is missing" if missing else "the file cannot be read", "check the path"
        ) from error
    try:
        with quiet_decoders():
            if head.startswith(b"\xff\xd8\xff"):
                decoded = _from_jpeg(path)
            elif head.startswith(MAGIC):
                decoded = _from_radiance(path)
            else:
                decoded = _decoded(path, outside)
    except MemoryError as error:
        raise MatcapError.at(
            where, "there is not enough memory to read it", "free some memory or reduce the picture"
        ) from error
    if not decoded.whole and not np.isfinite(decoded.stored).all():
        raise MatcapError.at(
            where,
            "has values that are not finite (NaN or infinity)",
            "replace them in a picture editor",
        )
    return decoded


def _from_jpeg(path: Path) -> Pixels:
    from PIL import Image

    if coding := unsupported_jpeg(path):
        raise _unsupported(path, coding)
    try:
        with warnings.catch_warnings(), path.open("rb") as file:
            warnings.simplefilter("ignore")  # large, and harmlessly malformed tags
            image = Image.open(file, formats=("JPEG", "MPO"))
            _check_size(path, *image.size)
            _check_colours(path, image.mode)
            image.load()
    except (MatcapError, MemoryError):
        raise
    except Image.DecompressionBombError as error:
        raise _too_large(path) from error
    except Exception as error:  # Pillow raises anything at all on broken bytes
        raise _broken(path) from error
    stored = np.asarray(image.convert("L") if image.mode == "1" else image)
    stored = stored[..., None] if stored.ndim == 2 else stored
    return Pixels(path, stored, dict.fromkeys(_RGB, 0) if stored.shape[2] == 1 else _RGB)


def _from_radiance(path: Path) -> Pixels:
    """Decode Radiance HDR by OpenImageIO, with a header reduced to what it supports."""
    try:
        header = radiance_header(path)
        _check_size(path, header.scanlines, header.texels)
        with tempfile.TemporaryDirectory() as place:
            plain = Path(place) / "plain.hdr"
            plain.write_bytes(header.plain() + path.read_bytes()[header.length :])
            stored = _decoded(plain, None).stored
    except (ValueError, OSError) as error:
        raise MatcapError.at(
            path, f"the Radiance file is damaged ({error})", "download it again"
        ) from error
    except MatcapError as error:
        raise MatcapError.at(path, error.what, error.remedy) from error
    return Pixels(path, header.upright(stored), _RGB, header.primaries)


def _decoded(path: Path, outside: float | None) -> Pixels:
    import OpenImageIO as oiio

    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(str(path), config)
    if source is None:
        forget_error(oiio.geterror)
        raise MatcapError.at(
            path,
            "this is not a readable picture",
            "give an EXR, TIFF, PNG, JPEG, TGA, BMP or WebP file",
        )
    try:
        spec, exr = source.spec(), source.format_name() == "openexr"
        refuse_deep(path, spec)
        _check_size(path, max(spec.width, spec.full_width), max(spec.height, spec.full_height))
        _check_colours(path, str(spec.getattribute("tiff:ColorSpace") or ""))
        roles = _roles(path, spec.channelnames)
        read = {"uint8": "uint8", "uint16": "uint16"}.get(str(spec.format), "float")
        stored = source.read_image(0, 0, 0, spec.nchannels, read)
        broken = forget_error(source.geterror)
    finally:
        source.close()
    if stored is None or broken:
        coding = str(spec.getattribute("compression") or "this")
        raise _unsupported(path, f"{coding} compression") if _NOT_BUILT in broken else _broken(path)
    stored, partial = np.asarray(stored), False
    if exr:  # in other formats an offset is the position on a page
        stored, partial = _in_display_window(path, spec, stored, outside)
    primaries = stated_primaries(spec) if exr else None
    return Pixels(
        path, stored, roles, primaries, str(spec.getattribute("textureformat") or ""), partial
    )


def _roles(path: Path, names: Sequence[str]) -> dict[str, int]:
    """Index of the channel by role; of several layers, those of the first with colours."""
    layers: dict[str, dict[str, int]] = {}
    for place, name in enumerate(names):
        layer, _, tail = name.rpartition(".")
        layers.setdefault(layer, {}).setdefault(tail.lower(), place)
    if any({"ry", "by"} & set(tails) for tails in layers.values()):
        raise MatcapError.at(
            path,
            "this EXR file holds luminance and chroma, which is not supported",
            "save it as RGB",
        )
    for tails in layers.values():
        known = _ROLES | (_AXES if {"x", "y"} <= set(tails) else {})
        roles = {known[tail]: place for tail, place in tails.items() if tail in known}
        if "R" in roles:
            return roles if "G" in roles else roles | dict.fromkeys(_RGB, roles["R"])
    tails = next(iter(layers.values()))
    alpha = next((tail for tail in tails if _ROLES.get(tail) == "A"), None)
    others = {tail: place for tail, place in tails.items() if tail != alpha} or tails
    named = [place for tail, place in others.items() if tail in _GREYS]
    if not named and len(others) > 1:
        raise MatcapError.at(
            path, f"none of its channels ({', '.join(names)[:80]}) is red or grey", "save it as RGB"
        )
    grey = (named or list(others.values()))[0]
    return dict.fromkeys(_RGB, grey) | ({} if alpha is None else {"A": tails[alpha]})


def _in_display_window(
    path: Path,
    spec: Any,  # noqa: ANN401
    stored: NDArray[Any],
    outside: float | None,
) -> tuple[NDArray[Any], bool]:
    """The display window of an EXR file, and whether the data window is smaller."""
    left, top = spec.x - spec.full_x, spec.y - spec.full_y
    width, height = spec.full_width, spec.full_height
    if (left, top, width, height) == (0, 0, spec.width, spec.height):
        return stored, False
    right, bottom = left + spec.width, top + spec.height
    partial = left > 0 or top > 0 or right < width or bottom < height
    if outside is None and partial:
        raise MatcapError.at(
            path,
            f"holds {spec.width} x {spec.height} of its {width} x {height} pixels (its data window "
            "is smaller than its display window)",
            "save it whole",
        )
    whole = np.full((height, width, stored.shape[2]), outside or 0.0, stored.dtype)
    rows, columns = slice(max(top, 0), min(bottom, height)), slice(max(left, 0), min(right, width))
    seen = stored[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]
    if seen.size:
        whole[rows, columns] = seen
    return whole, partial


def _check_size(path: Path, width: int, height: int) -> None:
    if width * height > MOST_PIXELS:
        raise _too_large(path)


def _check_colours(path: Path, space: str) -> None:
    if space in _NO_COLOURS:
        raise MatcapError.at(path, f"the picture's colours are {space}", "save it as RGB")


def _too_large(path: Path) -> MatcapError:
    return MatcapError.at(
        path,
        "the picture is larger than can be read",
        f"reduce it to under {MOST_PIXELS // 1_000_000} megapixels",
    )


def _unsupported(path: Path, what: str) -> MatcapError:
    return MatcapError.at(path, f"{what} is not supported", "save it in another coding")


def _broken(path: Path) -> MatcapError:
    return MatcapError.at(path, "the file is truncated or corrupt", "save or download it again")


def linear_colours(
    pixels: Pixels, *, light: bool = False
) -> tuple[NDArray[np.float32], tuple[str, ...]]:
    """(H, W, 3) linear Rec.709 of an image's colours, and notes to the user.

    Integers are converted from the file's colour space (stated_color.py), by default sRGB. Floats
    are linear unless the file has a profile; an EXR file's primaries are converted. Floats may be
    negative for colours outside Rec.709.

    Args:
        light: take integers as linear, whatever the file states.

    Raises:
        MatcapError: there are only two channels.
    """
    if "G" not in pixels.roles or "B" not in pixels.roles:
        raise MatcapError.at(pixels.path, "has two channels, which are no colour", "save it as RGB")
    colours = pixels.colours()
    if light and pixels.whole:
        return colours.astype(np.float32) / np.float32(np.iinfo(colours.dtype).max), ()
    stated = stated_color(pixels.path)
    if pixels.whole:
        linearise, notes = stated.lineariser(colours.dtype)
        return linearise(colours), notes
    if stated.profile is not None:
        linearise, notes = lineariser_of(stated.profile, colours.dtype, LINEAR)
        return linearise(colours), notes
    if pixels.primaries is None:
        return colours, ()
    try:
        matrix = rec709_from(pixels.primaries)
    except ValueError:
        return colours, ("The file's primaries span no colour space: Rec.709 assumed.",)
    if matrix is None:
        return colours, ()
    turned = colours @ matrix.T.astype(np.float32)
    return turned, ("Colours converted from the file's primaries to Rec.709.",)
