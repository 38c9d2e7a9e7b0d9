"""Simulated shots as files: a CFA DNG (Adobe DNG 1.4), 12 bits, uncompressed; a phone's JPEG.

Colours are converted by a phone-like sensor's matrix, the mosaic has black level and noise, EXIF
states focal length and flash. Optional lens shading is recorded as GainMaps in an OpcodeList2.
"""

from __future__ import annotations

import io
import math
import struct
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from matcap.files.color import srgb_picture
from matcap.files.output import Output
from matcap.photo.photo import ToneCurve
from matcap_lab.simulate.photograph import PhoneCamera, Shot, expose, sensor_noise

# Linear Rec.709 to XYZ at D65 (IEC 61966-2-1).
REC709_TO_XYZ = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)
# ColorMatrix1, rows of XYZ (D65) to camera colour; a phone's, rounded.
_MATRIX = np.array([[0.82, -0.27, -0.08], [-0.42, 1.25, 0.18], [-0.07, 0.18, 0.62]])
# Linear Rec.709 to camera colour, white's largest channel at 1; and white, AsShotNeutral.
_FROM_REC709 = _MATRIX @ REC709_TO_XYZ / (_MATRIX @ REC709_TO_XYZ).sum(axis=1).max()
_NEUTRAL = _FROM_REC709.sum(axis=1)
_BLACK, _WHITE = 256, 4095  # levels
_GAIN_MAP_POINTS = (13, 17)  # rows, columns
_GAIN_MAP_ID = 9
_DNG_1_3 = bytes((1, 3, 0, 0))
_D65 = 21
_CFA = 32803
_PIXELS_PER_MM = 289  # of a small sensor
_EXIF_IFD = 34665
_EXIF_PLACE = 34666  # unassigned; keeps the place of _EXIF_IFD, which tifffile refuses to write


def mosaic(shot: Shot, seed: int, shading: float = 0.0) -> NDArray[np.uint16]:
    """(H, W) RGGB mosaic of sensor codes; `shading` as of write_dng."""
    camera_colour = shot.linear @ _FROM_REC709.T
    height, width = shot.linear.shape[:2]
    plane = np.empty((height, width))
    for top, left, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        plane[top::2, left::2] = camera_colour[top::2, left::2, channel]
    if shading:
        plane = plane / _interpolated(gain_map(shading), width, height)
    plane = sensor_noise(plane, shot.camera, seed)
    numbers = _BLACK + plane * (_WHITE - _BLACK)
    return np.clip(np.round(numbers), 0, _WHITE).astype(np.uint16)


def gain_map(shading: float) -> NDArray[np.float32]:
    """(rows, columns) gains that correct the lens shading; see write_dng."""
    rows, columns = _GAIN_MAP_POINTS
    v, u = np.linspace(-1, 1, rows)[:, None], np.linspace(-1, 1, columns)[None, :]
    return (1.0 / (1.0 - shading * (u**2 + v**2) / 2.0)).astype(np.float32)


def write_dng(path: Path, shot: Shot, seed: int, shading: float = 0.0) -> None:
    """Write a shot as a DNG with the noise of a seed; the same arguments give the same file.

    `shading` of the lens, 1 - relative illumination in the corners, in [0, 1), is stored in
    GainMaps.

    Raises:
        MatcapError: the file cannot be written.
    """
    with Output.file(path) as file:
        tifffile.imwrite(
            file,
            mosaic(shot, seed, shading),
            photometric=_CFA,
            rowsperstrip=shot.camera.height,
            metadata=None,
            software="matcap",
            extratags=_tags(shot.camera, shading),
        )
        _append_exif(file, shot)


def exif_of(shot: Shot) -> dict[int, int | Fraction | bytes]:
    """EXIF tags of the shot by number, for DNG and JPEG."""
    camera = shot.camera
    width_mm = camera.width / _PIXELS_PER_MM
    length = Fraction(width_mm / 36.0 * camera.focal_length).limit_denominator(100_000)
    on_film = camera.focal_length * math.hypot(36.0, 24.0) / 36.0
    on_film *= camera.width / math.hypot(camera.width, camera.height)
    return {
        33434: Fraction(shot.exposure / 60.0).limit_denominator(1_000_000),  # ExposureTime, s
        33437: Fraction(9, 5),  # FNumber
        34855: 100,  # ISOSpeedRatings
        36864: b"0230",  # ExifVersion
        37385: 9 if shot.fired else 16,  # Flash: fired, or not, in compulsory mode
        37386: length,  # FocalLength, mm
        # FocalPlaneXResolution and its unit, cm: with them the field of view is exactly known.
        41486: Fraction(10 * _PIXELS_PER_MM),
        41488: 3,
        41989: round(on_film),  # FocalLengthIn35mmFilm, which refers to the diagonal (CIPA DCG-001)
    }


# (number, type, count, value, write once), as tifffile takes them.
_Tag = tuple[int, str, int, object, bool]


def _tags(camera: PhoneCamera, shading: float) -> list[_Tag]:
    matrix = [part for value in _MATRIX.flat for part in _rational(value)]
    neutral = [part for value in _NEUTRAL for part in _rational(value)]
    name = "matcap simulated phone"
    tags: list[_Tag] = [
        (254, "I", 1, 0, True),  # NewSubfileType: the main picture
        (271, "s", 0, "matcap", True),  # Make
        (272, "s", 0, "simulated phone", True),  # Model
        (274, "H", 1, 1, True),  # Orientation
        (33421, "H", 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, "B", 4, bytes((0, 1, 1, 2)), True),  # CFAPattern: RGGB
        (_EXIF_PLACE, "I", 1, 0, True),
        (50706, "B", 4, bytes((1, 4, 0, 0)), True),  # DNGVersion
        (50707, "B", 4, _DNG_1_3, True),  # DNGBackwardVersion
        (50708, "s", 0, name, True),  # UniqueCameraModel
        (50713, "H", 2, (1, 1), True),  # BlackLevelRepeatDim
        (50714, "H", 1, _BLACK, True),  # BlackLevel
        (50717, "I", 1, _WHITE, True),  # WhiteLevel
        (50721, "2i", 9, matrix, True),  # ColorMatrix1
        (50728, "2I", 3, neutral, True),  # AsShotNeutral
        (50778, "H", 1, _D65, True),  # CalibrationIlluminant1
    ]
    if shading:
        opcodes = _opcode_list(gain_map(shading), camera.width, camera.height)
        tags.append((51009, "B", len(opcodes), opcodes, True))  # OpcodeList2
    return tags


def _rational(value: float) -> tuple[int, int]:
    return round(value * 1_000_000), 1_000_000


def _opcode_list(gains: NDArray[np.float32], width: int, height: int) -> bytes:
    """One GainMap for each of the mosaic's four phases (DNG 1.4, chapter 7); big-endian."""
    rows, columns = gains.shape
    opcodes = []
    for top in (0, 1):
        for left in (0, 1):
            area = struct.pack(">4L", top, left, height, width)
            planes_and_pitch = struct.pack(">4L", 0, 1, 2, 2)
            points = struct.pack(">2L", rows, columns)
            spacing_and_origin = struct.pack(">4d", 1 / (rows - 1), 1 / (columns - 1), 0.0, 0.0)
            values = struct.pack(">L", 1) + gains.astype(">f4").tobytes()
            data = area + planes_and_pitch + points + spacing_and_origin + values
            opcodes.append(struct.pack(">L4sLL", _GAIN_MAP_ID, _DNG_1_3, 0, len(data)) + data)
    return struct.pack(">L", len(opcodes)) + b"".join(opcodes)


def _interpolated(gains: NDArray[np.float32], width: int, height: int) -> NDArray[np.float64]:
    """(H, W) bilinear gains at the pixels' centres."""
    rows, columns = gains.shape
    place_v = (np.arange(height) + 0.5) / height * (rows - 1)
    place_u = (np.arange(width) + 0.5) / width * (columns - 1)
    along_v = np.stack(
        [np.interp(place_v, np.arange(rows), gains[:, column]) for column in range(columns)], axis=1
    )
    return np.stack([np.interp(place_u, np.arange(columns), line) for line in along_v])


def _append_exif(file: Path, shot: Shot) -> None:
    """Append the EXIF IFD and its pointer: tifffile writes only the main IFD's tags."""
    with tifffile.TiffFile(file) as tiff:
        order = tiff.byteorder
        entry = tiff.pages.first.tags[_EXIF_PLACE].offset
    with file.open("r+b") as stream:
        where = stream.seek(0, 2)
        where += stream.write(bytes(where % 2))
        stream.write(_exif_directory(shot, where, order))
        stream.seek(entry)
        stream.write(struct.pack(order + "2HLL", _EXIF_IFD, 4, 1, where))


def _exif_directory(shot: Shot, where: int, order: str) -> bytes:
    tags = exif_of(shot)
    beyond = where + 2 + 12 * len(tags) + 4
    entries, values = b"", b""
    for number, value in tags.items():
        if isinstance(value, Fraction):
            kind, count = 5, 1
            stored = struct.pack(order + "L", beyond + len(values))
            values += struct.pack(order + "2L", value.numerator, value.denominator)
        elif isinstance(value, bytes):
            kind, count, stored = 7, len(value), value
        else:
            kind, count, stored = 3, 1, struct.pack(order + "H2x", value)
        entries += struct.pack(order + "2HL4s", number, kind, count, stored)
    return struct.pack(order + "H", len(tags)) + entries + struct.pack(order + "L", 0) + values


# A simulated shot as a phone's JPEG: sRGB, with EXIF.

# x^1.3 / (x^1.3 + 0.8^1.3), scaled to 1 at 1.
PHONE = ToneCurve(1.3, 1.0 / (1.0 + 0.8**1.3))
_QUALITY = 95
_ISO = b"urn:iso:std:iso:ts:21496:-1\0"


def write_jpeg(path: Path, shot: Shot, seed: int, tone: ToneCurve | None = None) -> None:
    """Write a shot as a JPEG of quality 95 with the noise of a seed; see write_dng.

    The tone curve is only sRGB's encoding by default.

    Raises:
        MatcapError: the file cannot be written.
    """
    linear = expose(shot, seed).astype(np.float32)
    shown = srgb_picture((tone or ToneCurve()).developed(linear))
    with Output.file(path) as file:
        file.write_bytes(_jpeg(shown, shot))


def write_gain_map_jpeg(path: Path, shot: Shot, seed: int) -> None:
    """Write a shot as a JPEG toned locally, with a gain map (ISO 21496-1) that undoes it.

    The map has a quarter of the resolution and one channel. Noise and errors as of write_jpeg.
    """
    light = sensor_noise(shot.linear, shot.camera, seed).clip(0.0).astype(np.float32)
    around = cv2.GaussianBlur(light.mean(axis=2), (0, 0), light.shape[1] / 40)[..., None]
    base = np.minimum(light / (0.6 + 0.9 * around), 1.0)
    offset = 1 / 64  # of both
    stops = np.log2((light.mean(axis=2) + offset) / (base.mean(axis=2) + offset))
    small = cv2.resize(stops, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    low, high = float(small.min()), float(small.max())
    block = struct.pack(">HHB", 0, 0, 0)
    for form, value in zip(
        "IIiiIii", (0.0, max(high, 0.1), low, high, 1.0, offset, offset), strict=True
    ):
        block += struct.pack(f">{form}I", round(value * 10**6), 10**6)
    with Output.file(path) as file:
        pictures = (
            _jpeg(srgb_picture(base), shot, bytes(4)),
            _jpeg((small - low) / (high - low), None, block),
        )
        file.write_bytes(b"".join(pictures))


def _jpeg(values: NDArray[np.float32], shot: Shot | None, gain_map: bytes = b"") -> bytes:
    """Values in [0, 1] as a JPEG, with a shot's EXIF and an APP2 segment of ISO 21496-1."""
    exif = Image.Exif()
    if shot is not None:
        exif.update({271: "matcap", 272: "simulated phone", 274: 1})
        exif.get_ifd(_EXIF_IFD).update(
            {
                number: IFDRational(value) if isinstance(value, Fraction) else value
                for number, value in exif_of(shot).items()
            }
        )
    file = io.BytesIO()
    codes = np.round(values * 255.0).astype(np.uint8)
    Image.fromarray(codes).save(file, format="JPEG", quality=_QUALITY, exif=exif)
    data, content = file.getvalue(), _ISO + gain_map
    segment = struct.pack(">HH", 0xFFE2, len(content) + 2) + content if gain_map else b""
    return data[:2] + segment + data[2:]
