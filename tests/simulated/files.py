"""A minimal CFA or linear DNG, written tag by tag, and a shot as a DNG or as a JPEG."""

import math
import struct
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from simulated.photographs import Shot, noisy

from matcap.files.color import srgb_picture

BLACK, WHITE = 64, 4095
CFA, LINEAR_RAW = 32803, 34892
# XYZ (D65) to linear Rec.709: with it as ColorMatrix, the camera's colours are Rec.709 already.
XYZ_TO_REC709 = (
    (3.2404542, -1.5371385, -0.4985314),
    (-0.9692660, 1.8760108, 0.0415560),
    (0.0556434, -0.2040259, 1.0572252),
)
_PLACEHOLDER = 34664
PATTERN = np.array([[0, 1], [1, 2]])  # RGGB


def rationals(values, scale: int = 10**7) -> tuple[int, ...]:
    return tuple(n for value in values for n in (round(value * scale), scale))


def mosaic(rgb: NDArray, *, black: int = BLACK, white: int = WHITE) -> NDArray[np.uint16]:
    """Camera colours (H, W, 3), 1.0 at the white level, to an RGGB mosaic."""
    rows, columns = np.indices(rgb.shape[:2])
    picked = np.take_along_axis(rgb, PATTERN[rows % 2, columns % 2][..., None], axis=2)[..., 0]
    return np.clip(np.rint(black + picked * (white - black)), 0, white).astype(np.uint16)


def gain_map(
    gains: NDArray,
    size: tuple[int, int],
    *,
    offset: tuple[int, int] = (0, 0),
    pitch: int = 1,
    planes: int = 1,
) -> bytes:
    """One GainMap opcode: gains (V, H, P) spread over the whole picture of size (height, width)."""
    gains = np.asarray(gains, dtype=">f4")
    points_v, points_h, map_planes = gains.shape
    payload = struct.pack(">4I", *offset, *size)
    payload += struct.pack(">4I", 0, planes, pitch, pitch)
    payload += struct.pack(">2I", points_v, points_h)
    payload += struct.pack(">4d", 1 / max(points_v - 1, 1), 1 / max(points_h - 1, 1), 0.0, 0.0)
    payload += struct.pack(">I", map_planes) + gains.tobytes()
    return struct.pack(">4I", 9, 0x01030000, 0, len(payload)) + payload


def opcode_list(*opcodes: bytes) -> bytes:
    return struct.pack(">I", len(opcodes)) + b"".join(opcodes)


def color_matrix(camera_of_rec709: NDArray) -> NDArray:
    """ColorMatrix (XYZ to camera) of a camera that mixes linear Rec.709 like this."""
    return np.asarray(camera_of_rec709) @ np.asarray(XYZ_TO_REC709)


def write_dng(
    path: Path,
    samples: NDArray[np.uint16],
    *,
    neutral: tuple[float, float, float] | None = (1.0, 1.0, 1.0),
    more: Sequence[tuple] = (),
    orientation: int = 1,
    opcodes2: bytes = b"",
    opcodes3: bytes = b"",
    black: int | tuple[int, ...] | None = BLACK,
    white: int | tuple[int, ...] = WHITE,
    exif: dict[int, int | Fraction] | None = None,
    color_matrix: ArrayLike = XYZ_TO_REC709,
    active_area: tuple[int, int, int, int] | None = None,
    **options: object,
) -> Path:
    """Samples (H, W) of a mosaic, or (H, W, 3) linear camera colours, as a DNG; `more` tags."""
    cfa = samples.ndim == 2
    planes = 1 if cfa else 3
    tags: list[tuple] = [
        (50706, 1, 4, bytes((1, 4, 0, 0)), True),
        (50707, 1, 4, bytes((1, 1, 0, 0)), True),
        (271, 2, 0, "matcap", True),
        (272, 2, 0, "test camera", True),
        (50708, 2, 0, "matcap test camera", True),
        (274, 3, 1, orientation, True),
        (50721, 10, 9, rationals(np.ravel(color_matrix)), True),
        (50778, 3, 1, 21, True),
        *more,
    ]
    for tag, level in ((50714, black), (50717, white)):
        if level is not None:
            whole = level if isinstance(level, tuple) or planes == 1 else (level,) * planes
            tags.append((tag, 3, planes, whole, True))
    if neutral is not None:
        tags.append((50728, 5, 3, rationals(neutral), True))
    if cfa:
        tags += [(33421, 3, 2, (2, 2), True), (33422, 1, 4, bytes((0, 1, 1, 2)), True)]
    if exif:
        tags.append((_PLACEHOLDER, 4, 1, 0, True))
    if active_area:
        tags.append((50829, 4, 4, active_area, True))
    if opcodes2:
        tags.append((51009, 7, len(opcodes2), opcodes2, True))
    if opcodes3:
        tags.append((51022, 7, len(opcodes3), opcodes3, True))
    tifffile.imwrite(
        path,
        samples,
        photometric=CFA if cfa else LINEAR_RAW,
        planarconfig=None if cfa else "contig",
        metadata=None,
        software=False,
        extratags=tags,
        **options,
    )
    if exif:
        _append_exif(path, exif)
    return path


def beside_preview(
    whole: Path, path: Path, samples: NDArray[np.uint16], orientation: int, **options: object
) -> Path:
    """A mosaic's DNG anew: a preview of this orientation first, the raw picture below it."""
    with tifffile.TiffFile(whole) as file:
        tags = [
            (tag.code, int(tag.dtype), tag.count, tag.value, True)
            for tag in file.pages.first.tags
            if tag.code > 33000 or tag.code == 274
        ]
    first = [tag for tag in tags if tag[0] in (50706, 50707, 50708, 50721, 50728, 50778)]
    rest = [tag for tag in tags if tag not in first]
    first.append((274, 3, 1, orientation, True))
    about = {"metadata": None, "software": False}
    with tifffile.TiffWriter(path) as out:
        shown = {"photometric": "rgb", "subifds": 1, "subfiletype": 1, "extratags": first}
        out.write(np.zeros((16, 24, 3), np.uint8), **shown, **about)
        out.write(samples, photometric=CFA, extratags=rest, **about, **options)
    return path


def _append_exif(path: Path, exif: dict[int, int | Fraction]) -> None:
    """Short integers and fractions by tag number, as an Exif IFD behind the picture."""
    data = path.read_bytes()
    # tifffile writes no Exif pointer itself: a placeholder of the number before becomes one.
    placeholder = data.index(struct.pack("<HHI", _PLACEHOLDER, 4, 1))
    at = len(data) + len(data) % 2
    pointer = struct.pack("<HHII", _PLACEHOLDER + 1, 4, 1, at)
    beyond, entries, values = at + 2 + 12 * len(exif) + 4, b"", b""
    for tag, value in sorted(exif.items()):
        if isinstance(value, Fraction):
            entries += struct.pack("<HHII", tag, 5, 1, beyond + len(values))
            values += struct.pack("<II", value.numerator, value.denominator)
        else:
            entries += struct.pack("<HHIHH", tag, 3, 1, value, 0)
    head = data[:placeholder] + pointer + data[placeholder + len(pointer) :]
    directory = struct.pack("<H", len(exif)) + entries + bytes(4) + values
    path.write_bytes(head.ljust(at, b"\0") + directory)


def _exif_of(shot: Shot) -> dict[int, int | Fraction]:
    """Exposure time, flash and focal length of a shot; the latter refers to film's diagonal."""
    camera = shot.camera
    across = camera.width / math.hypot(camera.width, camera.height) * math.hypot(36.0, 24.0)
    return {
        33434: Fraction(shot.exposure / 60.0).limit_denominator(1_000_000),
        33437: Fraction(9, 5),
        34855: 100,
        37385: 9 if shot.fired else 16,
        41989: round(camera.focal_length * across / 36.0),
    }


def write_shot(path: Path, shot: Shot, seed: int, shading: float = 0.0) -> Path:
    """A shot as a RAW file whose gain map undoes the lens's shading, its share in the corners."""
    height, width = shot.linear.shape[:2]
    u, v = np.linspace(-1.0, 1.0, width), np.linspace(-1.0, 1.0, height)[:, None]
    light = shot.linear * (1.0 - shading * (u**2 + v**2) / 2.0)[..., None]
    u, v = np.linspace(-1.0, 1.0, 17), np.linspace(-1.0, 1.0, 13)[:, None]
    gains = 1.0 / (1.0 - shading * (u**2 + v**2) / 2.0)
    maps = opcode_list(gain_map(gains[..., None], (height, width)))
    samples = mosaic(noisy(light, shot.camera, seed))
    return write_dng(path, samples, exif=_exif_of(shot), opcodes2=maps if shading else b"")


def write_jpeg(path: Path, shot: Shot, seed: int) -> None:
    """A shot as a JPEG of quality 95 without a tone curve but sRGB's."""
    code = srgb_picture(noisy(shot.linear, shot.camera, seed).astype(np.float32))
    exif = Image.Exif()
    exif.update({271: "matcap", 272: "simulated phone", 274: 1})
    for tag, value in _exif_of(shot).items():
        stored = IFDRational(value) if isinstance(value, Fraction) else value
        exif.get_ifd(34665)[tag] = stored
    Image.fromarray(np.round(code * 255.0).astype(np.uint8)).save(path, quality=95, exif=exif)
