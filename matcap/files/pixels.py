"""Reads the stored values of pictures and masks, and writes pictures: PNG, or EXR by suffix."""

from __future__ import annotations

import struct
import tempfile
import warnings
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.color import (
    LINEAR,
    LUMINANCE,
    ColorSpace,
    largest_code,
    linear,
    rec709_from,
    srgb_picture,
)
from matcap.files.containers import (
    APPLE_GAIN_MAP,
    FileKind,
    Tag,
    TiffPicture,
    check_pixels,
    decoding,
    kind_of,
    loaded_jpeg,
    meant_picture,
    missing_extra,
    pillow_reader,
    read_head,
    unreadable,
    unsupported,
    unsupported_jpeg,
)
from matcap.files.exr import forget_error, meant_layer, radiance_header, stated_primaries, write_exr
from matcap.files.names import check_suffix, note
from matcap.files.output import Output
from matcap.files.process import quiet_decoders
from matcap.files.stated_color import lineariser_of, space_of_name, stated_color

# Writes PNG files of 8 and 16 bits; values are rounded, not truncated.

PNG_HEADER = 33  # bytes: signature and IHDR


def write_png(path: Path, coded: NDArray[np.float32], *, bits: int) -> None:
    """Write code values (H, W, 3) or (H, W), clipped to [0, 1].

    Encoded in memory first, so that a full disk raises OSError. Not atomic: write into a staged
    folder.

    Raises:
        MatcapError: a value is not finite.
        OSError: the file cannot be written.
    """
    _check_finite(path, coded)
    path.write_bytes(png_bytes(quantised(coded, bits=bits)))


def _check_finite(path: Path, values: NDArray[np.float32]) -> None:
    if not np.isfinite(values).all():
        raise MatcapError("has values that are not finite", where=path.name)


def quantised(coded: NDArray[np.float32], *, bits: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Integer code values of finite values, clipped to [0, 1] and rounded; any shape."""
    whole = np.rint(np.clip(coded, 0.0, 1.0) * (2.0**bits - 1.0))
    return whole.astype(np.uint8) if bits == 8 else whole.astype(np.uint16)


def png_bytes(whole: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """Encode (H, W, 4), (H, W, 3) or (H, W) code values as PNG."""
    import cv2

    _, encoded = cv2.imencode(".png", swap_red_blue(whole))
    return encoded.tobytes()


def png_chunk(kind: bytes, data: bytes) -> bytes:
    """A chunk of a PNG file: length, type, data and checksum (PNG 3rd edition, 5.3)."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def swap_red_blue(whole: NDArray[Any]) -> NDArray[Any]:
    """(H, W, 4), (H, W, 3) or (H, W) with red and blue exchanged, for OpenCV."""
    import cv2

    whole = np.ascontiguousarray(whole)
    if whole.ndim == 2:
        return whole
    conversion = cv2.COLOR_RGB2BGR if whole.shape[2] == 3 else cv2.COLOR_RGBA2BGRA
    return np.asarray(cv2.cvtColor(whole, conversion))


# The reader of picture files, for photographs as for maps: JPEG, WebP and AVIF by Pillow, HEIC by
# pillow-heif, all others by OpenImageIO.
#
# Values are not converted, and alpha is not premultiplied. linear_colours() converts by the file's
# colour space (stated_color.py).

_RGB = {"R": 0, "G": 1, "B": 2}
# Integers of 32 bits are codes as well: 16 bits of them are kept.
_READ_AS = {"uint8": "uint8", "uint16": "uint16", "uint": "uint16", "uint32": "uint16"}
_SIGNED = ("int8", "int16", "int", "int32")
_LARGEST = 1e37  # values that matrices of colours keep finite
_MOST_PARTS = 64  # of an EXR that are looked at
_MODES = ("L", "LA", "RGB", "RGBA")  # Pillow's that are read directly
_STRIP = 1 << 22  # pixels that are copied at once
# Pixels beyond which a JPEG is decoded at half size (DCT scaling), if that suffices.
_LARGE = 100_000_000
Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass(frozen=True)
class Pixels:
    """Stored values of a picture."""

    path: Path
    stored: NDArray[Any]
    """(H, W, C) uint8, uint16 or float32."""
    roles: Mapping[str, int]
    """Index of the channel by role "R", "G", "B", "A"; equal for the colours of a grey image."""
    primaries: tuple[float, ...] | None = None
    """Chromaticities x, y of red, green, blue and white of an EXR file, or None."""
    space: str = ""
    """An EXR file's `colorInteropID`, such as lin_ap1_scene; or ""."""
    surroundings: str = ""
    """An EXR file's `textureformat`, which names the projection of an environment map; or ""."""
    partial: bool = False
    """Whether an EXR file's data window is smaller than its display window."""
    page: int = 0
    """Index of the picture in a TIFF file."""
    notes: tuple[str, ...] = ()
    """Sentences to the user on what was read of the file."""
    orientation: int = 1
    """EXIF's, of what is stored, by the decoder; 1 once the picture is upright."""
    whole_size: tuple[int, int] | None = None
    """(width, height) of the file's picture, if the decoder has reduced it."""
    info: Mapping[str, Any] = field(default_factory=dict)
    """Metadata that Pillow or pillow-heif returns."""
    gain_map: NDArray[Any] | None = None
    """(h, w) codes of a HEIC's auxiliary picture that is Apple's gain map, or None."""

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
        """(H, W, 3) stored colours, a view where they stand side by side; grey is repeated.

        Raises:
            KeyError: a colour is missing.
        """
        places = [self.roles[role] for role in _RGB]
        if places == [0, 1, 2]:
            return self.stored[..., :3]
        if len(set(places)) == 1:
            grey = self.stored[..., places[0], None]
            return np.broadcast_to(grey, (*grey.shape[:2], 3))
        return np.ascontiguousarray(self.stored[..., places])


def read_pixels(path: Path, *, outside: float | None = None, wanted: Sequence[str] = ()) -> Pixels:
    """Read a picture, upright by its Exif orientation, with a note if it turns; see decoded().

    Raises:
        MatcapError: as decoded().
    """
    pixels = decoded(path, outside=outside, wanted=wanted)
    if pixels.orientation == 1:
        return pixels
    stored = np.ascontiguousarray(upright(pixels.stored, pixels.orientation))
    says = f"Turned upright, as its Exif orientation ({pixels.orientation}) says."
    return replace(pixels, stored=stored, orientation=1, notes=(*pixels.notes, says))


def decoded(
    path: Path,
    *,
    outside: float | None = None,
    wanted: Sequence[str] = (),
    long_side: int | None = None,
) -> Pixels:
    """Read a picture in the orientation in which it is stored; of an EXR file the display window.

    Args:
        outside: value of the display window beyond the data window; None refuses such files.
        wanted: words for the data that the file should hold, by which an EXR's layer is chosen.
        long_side: pixels that suffice along the long side, for large JPEGs; None is all.

    Raises:
        MatcapError: missing, not a picture, truncated, too large, of an unsupported kind, with
            values that are not finite, or without a colour or grey channel.
    """
    kind = kind_of(read_head(path))
    with quiet_decoders(), decoding(path, kind.value), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # large, and harmlessly malformed tags
        if kind in (FileKind.JPEG, FileKind.WEBP, FileKind.AVIF):
            return _by_pillow(path, kind, long_side)
        if kind is FileKind.HEIC:
            return _from_heic(path)
        if kind is FileKind.RADIANCE:
            pixels = _from_radiance(path)
        else:
            pixels = _by_openimageio(path, kind, outside, wanted)
    if not pixels.whole and not np.isfinite(pixels.stored).all():
        raise MatcapError.at(
            path,
            "has values that are not finite (NaN or infinity)",
            "replace them in a picture editor",
        )
    return pixels


def _by_pillow(path: Path, kind: FileKind, long_side: int | None) -> Pixels:
    """Decode the first picture of a JPEG, WebP or AVIF."""
    try:
        reader = pillow_reader(kind)
    except ImportError as error:
        raise unsupported(path, f"{kind.value} by the Pillow that is installed") from error
    if kind is FileKind.JPEG and (coding := unsupported_jpeg(path)):
        raise unsupported(path, coding)
    with path.open("rb") as file:
        image = reader(file)
        size = image.size
        check_pixels(path, *size)
        if kind is FileKind.JPEG:
            enough = long_side is not None and 2 * long_side <= max(size)
            if size[0] * size[1] > _LARGE and enough:
                image.draft(image.mode, ((size[0] + 1) // 2, (size[1] + 1) // 2))
            image, notes = loaded_jpeg(image, path)
        else:
            image.load()
            several = getattr(image, "n_frames", 1) > 1
            notes = ("The first of several pictures is read.",) if several else ()
    if image.mode not in _MODES:
        if kind is FileKind.JPEG:
            raise unsupported(path, f"a JPEG of {image.mode} colours")
        image = image.convert("RGB")
    # By strips, as Pillow copies twice what is asked for.
    stored = np.empty((image.height, image.width, len(image.getbands())), np.uint8)
    step = max(1, _STRIP // image.width)
    for top in range(0, image.height, step):
        strip = np.asarray(image.crop((0, top, image.width, min(top + step, image.height))))
        stored[top : top + step] = strip.reshape(*strip.shape[:2], -1)
    orientation = image.getexif().get(Tag.Orientation, 1) if kind is FileKind.JPEG else 1
    return Pixels(
        path,
        stored,
        _roles(stored),
        notes=notes,
        orientation=orientation if orientation in range(2, 9) else 1,
        whole_size=None if image.size == size else size,
        info=dict(image.info),
    )


def _roles(stored: NDArray[Any]) -> Mapping[str, int]:
    """Roles of one to four channels; the last of two or four is alpha."""
    count = stored.shape[2]
    colours = _RGB if count > 2 else dict.fromkeys(_RGB, 0)
    return {**colours, "A": count - 1} if count in (2, 4) else colours


def _from_heic(path: Path) -> Pixels:
    """Decode a HEIC, of 8 bits, or of up to 12 that are extended to 16 by repeating them."""
    try:
        import pillow_heif
    except ImportError as error:
        raise missing_extra(path, "HEIC", "heic") from error
    image: Any = pillow_heif.open_heif(path, convert_hdr_to_8bit=False)
    check_pixels(path, *image.size)
    stored, info = np.asarray(image), dict(image.info)
    stored = stored.reshape(*stored.shape[:2], -1)
    if stored.dtype == np.uint16:
        stored = stored | stored >> int(info.get("bit_depth") or 10)
    maps = info.get("aux", {}).get(APPLE_GAIN_MAP, ())
    gain_map = np.asarray(image.get_aux_image(maps[0])) if maps else None
    return Pixels(path, stored, _roles(stored), info=info, gain_map=gain_map)


def _from_radiance(path: Path) -> Pixels:
    """Decode Radiance HDR by OpenImageIO, with a header reduced to what it supports."""
    try:
        header = radiance_header(path)
        check_pixels(path, header.scanlines, header.texels)
        with tempfile.TemporaryDirectory() as place:
            plain = Path(place) / "plain.hdr"
            plain.write_bytes(header.plain() + path.read_bytes()[header.length :])
            stored = _by_openimageio(plain, FileKind.RADIANCE, None, ()).stored
    except (ValueError, OSError) as error:
        raise MatcapError.at(
            path, f"the Radiance file is damaged ({error})", "download it again"
        ) from error
    except MatcapError as error:
        raise MatcapError.at(path, error.what, error.remedy) from error
    return Pixels(path, header.upright(stored), _RGB, header.primaries)


def _by_openimageio(
    path: Path, kind: FileKind, outside: float | None, wanted: Sequence[str]
) -> Pixels:
    import OpenImageIO as oiio

    page = meant_picture(path) if kind is FileKind.TIFF else TiffPicture()
    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)  # colours not multiplied by alpha
    source = oiio.ImageInput.open(str(path), config)
    if source is None:
        fault = forget_error(oiio.geterror)  # or it is printed at exit
        raise _not_decoded(path, kind, page, fault)
    try:
        exr = source.format_name() == "openexr"
        part = page.index
        if exr:
            layer, notes = meant_layer(_parts(source), wanted, str(path))
            part = layer.part
        if not source.seek_subimage(part, 0):
            raise _not_decoded(path, kind, page, forget_error(source.geterror))
        if not exr:
            layer, notes = meant_layer([source.spec()], wanted, str(path))
        spec = source.spec()
        check_pixels(path, max(spec.width, spec.full_width), max(spec.height, spec.full_height))
        read = _READ_AS.get(str(spec.format), "float")
        stored = source.read_image(part, 0, 0, spec.nchannels, read)
        fault = forget_error(source.geterror)
    finally:
        source.close()
    if stored is None or fault:
        raise _not_decoded(path, kind, page, fault)
    stored, partial = page.as_meant(np.asarray(stored), spec.alpha_channel), False
    if str(spec.format) in _SIGNED and stored.min() >= 0.0:  # codes; below 0 they are vectors
        stored = np.rint(stored * np.float32(65535)).astype(np.uint16)
    if exr:  # in other formats an offset is the position on a page
        stored, partial = _in_display_window(path, spec, stored, outside)
    orientation = 1 if exr else spec.getattribute("Orientation")
    return Pixels(
        path,
        stored,
        layer.roles,
        stated_primaries(spec) if exr else None,
        str(spec.getattribute("colorInteropID") or "") if exr else "",
        str(spec.getattribute("textureformat") or ""),
        partial,
        page.index,
        page.notes + notes,
        orientation if orientation in range(2, 9) else 1,
    )


def _not_decoded(path: Path, kind: FileKind, page: TiffPicture, fault: str) -> MatcapError:
    """The error for a picture that OpenImageIO does not decode."""
    if page.compression:
        return unsupported(path, f"TIFF compression {page.compression}")
    if kind is FileKind.OTHER and "truncated" not in fault:
        return MatcapError.at(
            path,
            "this is not a readable picture",
            "give an EXR, TIFF, PNG, JPEG, TGA, BMP or WebP file",
        )
    return unreadable(path, kind.value)


def _parts(source: Any) -> list[Any]:  # noqa: ANN401
    """OpenImageIO's specification of each part of an open EXR file."""
    specs: list[Any] = []
    while len(specs) < _MOST_PARTS and source.seek_subimage(len(specs), 0):
        specs.append(source.spec().copy())
    forget_error(source.geterror)
    return specs


def upright(picture: NDArray[Scalar], orientation: int) -> NDArray[Scalar]:
    """Upright view of a stored picture (H, W, ...); `orientation` is EXIF's, 1 to 8."""
    if orientation in (5, 6, 7, 8):
        picture = picture.swapaxes(0, 1)
    if orientation in (2, 3, 6, 7):
        picture = picture[:, ::-1]
    if orientation in (3, 4, 7, 8):
        picture = picture[::-1]
    return picture


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


def linear_colours(
    pixels: Pixels, *, named: str = ""
) -> tuple[NDArray[np.float32], tuple[str, ...]]:
    """(H, W, 3) linear Rec.709 of an image's colours, and notes to the user.

    Integers are converted from the file's colour space (stated_color.py), by default sRGB. Floats
    are linear unless the file has a profile or a `colorInteropID` of a curve; primaries that an EXR
    or TIFF states are converted. Floats may be negative for colours outside Rec.709.

    Args:
        named: colour space that the file's name states, as space_of_name() has them; for integers
            before what the file states, for floats after it.

    Raises:
        MatcapError: there are only two channels.
    """
    if "G" not in pixels.roles or "B" not in pixels.roles:
        raise MatcapError.at(pixels.path, "has two channels, which are no colour", "save it as RGB")
    colours = pixels.colours()
    with quiet_decoders():
        stated = stated_color(pixels.path, pixels.page)
    if pixels.whole:
        if named:
            return _from_space(colours, space_of_name(named), named, "the name's")
        linearise, notes = stated.lineariser(colours.dtype)
        return linearise(colours), notes
    if stated.profile is not None:
        linearise, notes = lineariser_of(stated.profile, colours.dtype, LINEAR)
        return linearise(colours), notes
    if pixels.space:
        return _from_space(colours, space_of_name(pixels.space), pixels.space, "the file's")
    matrix = stated.space.matrix
    if pixels.primaries is not None:
        try:
            matrix = rec709_from(pixels.primaries)
        except ValueError:
            return colours, ("The file's primaries span no colour space: Rec.709 assumed.",)
    elif matrix is None and named:
        return _from_space(colours, space_of_name(named), named, "the name's")
    if matrix is None:
        return colours, ()
    return _from_space(
        colours, ColorSpace("primaries", LINEAR.curves, matrix), "primaries", "the file's"
    )


def _from_space(
    colours: NDArray[Any], space: ColorSpace | None, name: str, whose: str
) -> tuple[NDArray[np.float32], tuple[str, ...]]:
    """Colours of a named space; of an unknown one as linear Rec.709, with a note."""
    light: Any = colours.astype(np.float32) / np.float32(largest_code(colours.dtype))
    if space is None:
        return light, (
            f"Nothing is known of {whose} colour space {name!r}: linear Rec.709 assumed.",
        )
    if space.curves[0] is not linear:
        light = np.stack([space.curves[c](light[..., c]) for c in range(3)], axis=-1)
    if space.matrix is not None:
        bounded = np.asarray(np.clip(light, -_LARGEST, _LARGEST), np.float32)
        light = bounded @ space.matrix.T.astype(np.float32)
    notes = () if space is LINEAR else (f"Colours converted from {whose} {space.name} to Rec.709.",)
    return np.asarray(light, np.float32), notes


# Writes an image to a file: linear EXR or sRGB PNG, by suffix.

SUFFIXES = (".png", ".exr")
_ROWS = 256  # of a picture that are encoded at once


def write_picture(
    image: NDArray[np.float32],
    path: Path,
    encode: Callable[[NDArray[np.float32]], NDArray[np.float32]] = srgb_picture,
) -> None:
    """Write a linear Rec.709 picture (H, W, 3): .exr as float32 radiance, .png as 8-bit codes.

    Args:
        encode: code values in [0, 1] of rows of the picture, for PNG.

    Raises:
        UsageError: another suffix.
        MatcapError: values that are not finite, or the file cannot be written.
    """
    check_suffix(path, SUFFIXES, "picture")
    with Output.file(path) as file:
        if path.suffix.lower() == ".exr":
            write_exr(file, image, half=False)
            return
        codes = np.empty(image.shape, np.uint8)
        for top in range(0, len(image), _ROWS):  # in strips, to bound memory
            rows = image[top : top + _ROWS]
            _check_finite(path, rows)
            codes[top : top + _ROWS] = quantised(encode(rows), bits=8)
        file.write_bytes(png_bytes(codes))


# Reads masks from images, as grey or as transparency.

_STEP = 1.5 / 255.0  # code values that differ by less count as equal


def read_mask(path: Path) -> NDArray[np.float32]:
    """(H, W) mask in [0, 1] of an image.

    An opaque image's mask is its luma, in code values. A transparent image of a single colour, even
    black, or of colours, has its alpha as the mask; one of greys has luma times alpha.

    Raises:
        MatcapError: missing, not an image, wholly transparent, or floats outside [0, 1].
    """
    pixels = read_pixels(path)
    for sentence in pixels.notes:
        note(f"{path}: {sentence}")
    red, green, blue = (pixels.channel(role if role in pixels.roles else "R") for role in _RGB)
    grey = red
    if not pixels.grey:
        r, g, b = (np.float32(weight) for weight in LUMINANCE)
        grey = np.asarray(r * red + g * green + b * blue, np.float32)
    if not pixels.whole and not 0.0 <= float(grey.min()) <= float(grey.max()) <= 1.0:
        raise MatcapError.at(
            path,
            f"has values from {grey.min():.3g} to {grey.max():.3g}, not from 0 to 1",
            "save it as a PNG of 8 or 16 bits",
        )
    if "A" not in pixels.roles:
        return grey
    alpha = np.clip(pixels.channel("A"), 0.0, 1.0)
    seen = alpha > 0.0
    if not seen.any():
        raise MatcapError.at(path, "all of it is transparent", "save it without transparency")
    if float(alpha.min()) >= 1.0 - 1e-6:
        return grey
    spread = np.maximum(np.abs(red - green), np.abs(green - blue))[seen]
    if float(np.ptp(grey[seen])) < _STEP or float(spread.mean()) > _STEP:
        return alpha
    return grey * alpha
