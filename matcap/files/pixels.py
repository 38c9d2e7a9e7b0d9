"""Reads the stored values of images and masks, and writes pictures: PNG, or EXR by suffix."""

from __future__ import annotations

import io
import struct
import tempfile
import warnings
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.color import LINEAR, LUMINANCE, largest_code, linear, rec709_from, srgb_picture
from matcap.files.containers import (
    NO_RGB,
    Tag,
    TiffPicture,
    is_tiff,
    loaded_jpeg,
    meant_picture,
    unsupported_jpeg,
)
from matcap.files.exr import (
    MAGIC,
    forget_error,
    meant_layer,
    radiance_header,
    stated_primaries,
    write_exr,
)
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
    if not np.isfinite(coded).all():
        raise MatcapError("has values that are not finite", where=path.name)
    path.write_bytes(png_bytes(quantised(coded, bits=bits)))


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


# Reads the stored values of images: EXR, TIFF, PNG, JPEG, TGA, BMP, WebP, Radiance HDR.
#
# Values are not converted, and alpha is not premultiplied. Pillow decodes JPEG, because it reports
# truncated files; OpenImageIO decodes the rest. linear_colours() converts by the file's colour
# space (stated_color.py). Photographs are read strip by strip in matcap/photo.

MOST_PIXELS = 2**28  # 16384 x 16384; a header may claim any size
_RGB = {"R": 0, "G": 1, "B": 2}
# Integers of 32 bits are codes as well: 16 bits of them are kept.
_READ_AS = {"uint8": "uint8", "uint16": "uint16", "uint": "uint16", "uint32": "uint16"}
_SIGNED = ("int8", "int16", "int", "int32")
_LARGEST = 1e37  # values that matrices of colours keep finite
_MOST_PARTS = 64  # of an EXR that are looked at
Scalar = TypeVar("Scalar", bound=np.generic)
_NOT_BUILT = "not configured"  # in libtiff's error for a compression that it was built without
# Colour spaces that the decoders do not convert.
_NO_COLOURS = ("CMYK", "YCCK", *NO_RGB.values())


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


def read_pixels(path: Path, *, outside: float | None = None, wanted: Sequence[str] = ()) -> Pixels:
    """Read an image, upright by its Exif orientation; of an EXR file the display window.

    Args:
        outside: value of the display window beyond the data window; None refuses such files.
        wanted: words for the data that the file should hold, by which an EXR's layer is chosen.

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
                decoded = _decoded(path, head, outside, wanted)
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
    from PIL.JpegImagePlugin import JpegImageFile

    if coding := unsupported_jpeg(path):
        raise _unsupported(path, coding)
    try:
        with warnings.catch_warnings(), path.open("rb") as file:
            warnings.simplefilter("ignore")  # large, and harmlessly malformed tags
            image: Any = JpegImageFile(file)
            _check_size(path, *image.size)
            _check_colours(path, image.mode)
            image, notes = loaded_jpeg(image, path)
    except (MatcapError, MemoryError):
        raise
    except Exception as error:  # Pillow raises anything at all on broken bytes
        raise _broken(path) from error
    stored = np.asarray(image.convert("L") if image.mode == "1" else image)
    stored = stored[..., None] if stored.ndim == 2 else stored
    roles = dict.fromkeys(_RGB, 0) if stored.shape[2] == 1 else _RGB
    pixels = Pixels(path, stored, roles, notes=notes)
    return _standing(pixels, image.getexif().get(Tag.Orientation, 1))


def _from_radiance(path: Path) -> Pixels:
    """Decode Radiance HDR by OpenImageIO, with a header reduced to what it supports."""
    try:
        header = radiance_header(path)
        _check_size(path, header.scanlines, header.texels)
        with tempfile.TemporaryDirectory() as place:
            plain = Path(place) / "plain.hdr"
            plain.write_bytes(header.plain() + path.read_bytes()[header.length :])
            stored = _decoded(plain, MAGIC, None, ()).stored
    except (ValueError, OSError) as error:
        raise MatcapError.at(
            path, f"the Radiance file is damaged ({error})", "download it again"
        ) from error
    except MatcapError as error:
        raise MatcapError.at(path, error.what, error.remedy) from error
    return Pixels(path, header.upright(stored), _RGB, header.primaries)


def _decoded(path: Path, head: bytes, outside: float | None, wanted: Sequence[str]) -> Pixels:
    import OpenImageIO as oiio

    page = _tiff_picture(path) if is_tiff(head) else TiffPicture()
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
        exr = source.format_name() == "openexr"
        part = page.index
        if exr:
            layer, notes = meant_layer(_parts(source), wanted, str(path))
            part = layer.part
        if not source.seek_subimage(part, 0):
            forget_error(source.geterror)
            raise _broken(path)
        if not exr:
            layer, notes = meant_layer([source.spec()], wanted, str(path))
        spec = source.spec()
        _check_size(path, max(spec.width, spec.full_width), max(spec.height, spec.full_height))
        _check_colours(path, str(spec.getattribute("tiff:ColorSpace") or ""))
        read = _READ_AS.get(str(spec.format), "float")
        stored = source.read_image(part, 0, 0, spec.nchannels, read)
        broken = forget_error(source.geterror)
    finally:
        source.close()
    if stored is None or broken:
        coding = str(spec.getattribute("compression") or "this")
        raise _unsupported(path, f"{coding} compression") if _NOT_BUILT in broken else _broken(path)
    stored, partial = page.as_meant(np.asarray(stored), spec.alpha_channel), False
    if str(spec.format) in _SIGNED and stored.min() >= 0.0:  # codes; below 0 they are vectors
        stored = np.rint(stored * np.float32(65535)).astype(np.uint16)
    if exr:  # in other formats an offset is the position on a page
        stored, partial = _in_display_window(path, spec, stored, outside)
    pixels = Pixels(
        path,
        stored,
        layer.roles,
        stated_primaries(spec) if exr else None,
        str(spec.getattribute("colorInteropID") or "") if exr else "",
        str(spec.getattribute("textureformat") or ""),
        partial,
        page.index,
        page.notes + notes,
    )
    return pixels if exr else _standing(pixels, spec.getattribute("Orientation") or 1)


def _parts(source: Any) -> list[Any]:  # noqa: ANN401
    """OpenImageIO's specification of each part of an open EXR file."""
    specs: list[Any] = []
    while len(specs) < _MOST_PARTS and source.seek_subimage(len(specs), 0):
        specs.append(source.spec().copy())
    forget_error(source.geterror)
    return specs


def _tiff_picture(path: Path) -> TiffPicture:
    try:
        page = meant_picture(path)
    except MemoryError:
        raise
    except Exception as error:  # tifffile raises anything at all on broken bytes
        raise _broken(path) from error
    _check_colours(path, NO_RGB.get(page.photometric, ""))
    if page.refused:
        raise _unsupported(path, page.refused)
    return page


def _standing(pixels: Pixels, orientation: Any) -> Pixels:  # noqa: ANN401
    """The picture upright, by EXIF's orientation of what is stored; with a note if it turns."""
    if orientation not in range(2, 9):
        return pixels
    stored = np.ascontiguousarray(upright(pixels.stored, int(orientation)))
    note = f"Turned upright, as its Exif orientation ({orientation}) says."
    return replace(pixels, stored=stored, notes=(*pixels.notes, note))


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
    pixels: Pixels, *, named: str = ""
) -> tuple[NDArray[np.float32], tuple[str, ...]]:
    """(H, W, 3) linear Rec.709 of an image's colours, and notes to the user.

    Integers are converted from the file's colour space (stated_color.py), by default sRGB. Floats
    are linear unless the file has a profile or a `colorInteropID` of a curve; an EXR file's
    primaries are converted. Floats may be negative for colours outside Rec.709.

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
            return _from_space(colours, named, "the name's")
        linearise, notes = stated.lineariser(colours.dtype)
        return linearise(colours), notes
    if stated.profile is not None:
        linearise, notes = lineariser_of(stated.profile, colours.dtype, LINEAR)
        return linearise(colours), notes
    if pixels.space:
        return _from_space(colours, pixels.space, "the file's")
    if pixels.primaries is None:
        return _from_space(colours, named, "the name's") if named else (colours, ())
    try:
        matrix = rec709_from(pixels.primaries)
    except ValueError:
        return colours, ("The file's primaries span no colour space: Rec.709 assumed.",)
    if matrix is None:
        return colours, ()
    turned = _bounded(colours) @ matrix.T.astype(np.float32)
    return turned, ("Colours converted from the file's primaries to Rec.709.",)


def _bounded(colours: NDArray[Any]) -> NDArray[np.float32]:
    """Colours that no matrix of colours makes infinite."""
    return np.asarray(np.clip(colours, -_LARGEST, _LARGEST), np.float32)


def _from_space(
    colours: NDArray[Any], name: str, whose: str
) -> tuple[NDArray[np.float32], tuple[str, ...]]:
    """Colours of a named space; of an unknown one as linear Rec.709, with a note."""
    space = space_of_name(name)
    light: Any = colours.astype(np.float32) / np.float32(largest_code(colours.dtype))
    if space is None:
        return light, (
            f"Nothing is known of {whose} colour space {name!r}: linear Rec.709 assumed.",
        )
    if space.curves[0] is not linear:
        light = np.stack([space.curves[c](light[..., c]) for c in range(3)], axis=-1)
    if space.matrix is not None:
        light = _bounded(light) @ space.matrix.T.astype(np.float32)
    notes = () if space is LINEAR else (f"Colours converted from {whose} {space.name} to Rec.709.",)
    return np.asarray(light, np.float32), notes


# Writes an image to a file: linear EXR or sRGB PNG, by suffix.

SUFFIXES = (".exr", ".png")


def jpeg_bytes(linear: NDArray[np.float32], quality: int, **options: int) -> bytes:
    """A JPEG of a linear Rec.709 picture (H, W, 3), encoded by Pillow with these options."""
    from PIL import Image

    stored = io.BytesIO()
    codes = quantised(srgb_picture(linear), bits=8)
    Image.fromarray(codes).save(stored, "JPEG", quality=quality, **options)
    return stored.getvalue()


def write_picture(image: NDArray[np.float32], path: Path) -> None:
    """Write a linear Rec.709 picture (H, W, 3): .exr as float32 radiance, .png as 8-bit sRGB.

    Raises:
        UsageError: another suffix.
        MatcapError: values that are not finite, or the file cannot be written.
    """
    check_suffix(path, SUFFIXES, "picture")
    with Output.file(path) as file:
        if path.suffix.lower() == ".exr":
            write_exr(file, image, half=False)
        else:
            write_png(file, srgb_picture(image), bits=8)


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
    red, green, blue = (
        pixels.channel(role if role in pixels.roles else "R") for role in ("R", "G", "B")
    )
    grey = (
        red
        if pixels.grey
        else sum(
            np.float32(weight) * plane
            for weight, plane in zip(LUMINANCE, (red, green, blue), strict=True)
        )
    )
    grey = np.asarray(grey, np.float32)
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
