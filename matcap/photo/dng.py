"""DNG tags that LibRaw ignores: lens shading, white balance, colours (Adobe DNG 1.7.1).

Camera colours are converted to white-balanced Rec.709 as in its chapter 6. LibRaw uses
AsShotNeutral and a single matrix. Here white is from AsShotNeutral or AsShotWhiteXY, by default
D65; matrices are interpolated between the calibration illuminants by the white's colour
temperature; CameraCalibration, AnalogBalance and ForwardMatrix are used. Third illuminants and
reduction matrices are ignored.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from matcap.files.color import LINEAR, REC709_TO_D50, ColorSpace
from matcap.files.containers import Tag, decoding, unsupported
from matcap.files.stated_color import StatedColor
from matcap.photo import raw_samples
from matcap.photo.developed import decode, light
from matcap.photo.photo import Decoded, check_size
from matcap.photo.raw_samples import VALUE_MAPPING, Opcodes, Tags, finite_numbers, parse_opcodes

Matrix = NDArray[np.float64]

_D65 = (0.3127, 0.3290)
# Linear Rec.709 to XYZ, D65 (IEC 61966-2-1).
_REC709_TO_XYZ = np.array(
    [
        [0.4123908, 0.3575843, 0.1804808],
        [0.2126390, 0.7151687, 0.0721923],
        [0.0193308, 0.1191948, 0.9505322],
    ]
)
_COLOR = (Tag.ColorMatrix1, Tag.ColorMatrix2)
_CALIBRATION = (Tag.CameraCalibration1, Tag.CameraCalibration2)
_FORWARD = (Tag.ForwardMatrix1, Tag.ForwardMatrix2)
_ILLUMINANTS = (Tag.CalibrationIlluminant1, Tag.CalibrationIlluminant2)
_SIGNATURES = (Tag.CameraCalibrationSignature, Tag.ProfileCalibrationSignature)
# Kelvin of Exif's LightSource, as Adobe's DNG SDK has them.
_KELVIN = {
    1: 5500.0, 2: 4150.0, 3: 2850.0, 4: 5500.0, 9: 5500.0, 10: 6500.0, 11: 7500.0, 12: 6400.0,
    13: 5050.0, 14: 4150.0, 15: 3525.0, 16: 2925.0, 17: 2850.0, 18: 5500.0, 19: 6500.0,
    20: 5500.0, 21: 6500.0, 22: 7500.0, 23: 5000.0, 24: 3200.0,
}  # fmt: skip
_ROUNDS = 30  # iterations of white_of


@dataclass(frozen=True)
class DngColor:
    """Conversion from a DNG's camera colours to Rec.709."""

    neutral: tuple[float, float, float]
    """(3,) camera colours of white; white balance divides by it."""
    matrix: Matrix
    """(3, 3) from white-balanced camera colours to linear Rec.709; rows sum to 1."""
    note: str = ""
    """Note to the user if the file states no neutral, or ""."""


def dng_color(tags: Tags) -> DngColor | None:
    """Compute a DNG's conversion; None if it has no matrix for three colours.

    Args:
        tags: TIFF tags of the raw picture, and of the first page, by number.

    Raises:
        ValueError, TypeError: the tags are invalid.
    """
    camera = _Camera.of(tags)
    if camera is None:
        return None
    neutral = finite_numbers(tags, Tag.AsShotNeutral, 3)
    stated = finite_numbers(tags, Tag.AsShotWhiteXY, 2)
    note = ""
    if neutral is not None and neutral.min() > 0.0:
        white = camera.white_of(neutral)
    elif stated is not None and stated.min() >= 0.05 and stated.sum() <= 0.95:
        white = (float(stated[0]), float(stated[1]))
        neutral = camera.neutral_of(white)
        note = "White balance from the file's white point ({:.4f}, {:.4f}).".format(*white)
    else:
        white, neutral = _D65, camera.neutral_of(_D65)
        note = "The file states no white balance: daylight (D65) assumed."
    if not (np.isfinite(neutral).all() and neutral.min() > 1e-3 * neutral.max() > 0.0):
        raise ValueError("no white that a camera could see")
    red, green, blue = (neutral / neutral.max()).tolist()
    return DngColor((red, green, blue), camera.to_rec709(white, neutral), note)


@dataclass(frozen=True)
class _Camera:
    """Matrices for one or two calibration illuminants."""

    kelvin: tuple[float, ...]
    """Colour temperature of each illuminant."""
    color: tuple[Matrix, ...]
    """Matrices from XYZ to the reference camera, for each."""
    own: tuple[Matrix, ...]
    """Matrices from the reference camera to this one, AnalogBalance times CameraCalibration."""
    forward: tuple[Matrix, ...] | None
    """Matrices from the white-balanced reference camera to XYZ relative to D50, or None."""

    @staticmethod
    def of(tags: Tags) -> _Camera | None:
        color = [_matrix(tags, tag) for tag in _COLOR]
        stated = [int(raw_samples.numbers(tags, tag, (-1.0,))[0]) for tag in _ILLUMINANTS]
        known = [_KELVIN.get(illuminant, 0.0) for illuminant in stated]
        # Two matrices are used only if both illuminants are known and differ.
        both = color[1] is not None and min(known) > 0.0 and known[0] != known[1]
        kept = [i for i in (0, 1) if color[i] is not None][: 2 if both else 1]
        if not kept:
            return None
        gains = finite_numbers(tags, Tag.AnalogBalance, 3)
        balance = np.eye(3) if gains is None or gains.min() <= 0.0 else np.diag(gains)
        signatures = [_text(tags, tag) for tag in _SIGNATURES]
        same = signatures[0] == signatures[1]
        calibrations = [_matrix(tags, tag) if same else None for tag in _CALIBRATION]
        own = [balance @ (np.eye(3) if c is None else c) for c in calibrations]
        forward = [_matrix(tags, tag) for tag in _FORWARD]
        whole = all(forward[i] is not None for i in kept)
        return _Camera(
            tuple(known[i] for i in kept),
            tuple(c for i in kept if (c := color[i]) is not None),
            tuple(own[i] for i in kept),
            tuple(f for i in kept if (f := forward[i]) is not None) if whole else None,
        )

    def neutral_of(self, white: tuple[float, float]) -> Matrix:
        """(3,) camera colours of a white (x, y)."""
        x, y = white
        return np.asarray(self._from_xyz(white) @ [x / y, 1.0, (1.0 - x - y) / y])

    def white_of(self, neutral: Matrix) -> tuple[float, float]:
        """White (x, y) of camera colours, iteratively, as the matrix depends on its temperature."""
        white = (0.3457, 0.3585)  # D50, the initial value in the specification
        for _ in range(_ROUNDS):
            x, y, z = np.linalg.solve(self._from_xyz(white), neutral)
            total = x + y + z
            if not total > 0.0 or not 0.0 < y / total < 1.0:
                return _D65
            estimate = (float(x / total), float(y / total))
            if abs(estimate[0] - white[0]) + abs(estimate[1] - white[1]) < 1e-7:
                return estimate
            # A half step, as full ones may oscillate.
            white = ((white[0] + estimate[0]) / 2.0, (white[1] + estimate[1]) / 2.0)
        return white

    def to_rec709(self, white: tuple[float, float], neutral: Matrix) -> Matrix:
        """(3, 3) from white-balanced camera colours to Rec.709; white is (1, 1, 1) in both."""
        own = self._mixed(self.own, white)
        if self.forward is not None:
            reference = np.linalg.solve(own, np.diag(neutral))
            reference /= reference.sum(axis=1, keepdims=True)
            to_d50 = self._mixed(self.forward, white) @ reference
            matrix = np.linalg.solve(REC709_TO_D50, to_d50)
        else:
            seen = own @ self._mixed(self.color, white) @ _REC709_TO_XYZ
            matrix = np.linalg.inv(seen / seen.sum(axis=1, keepdims=True))
        matrix /= matrix.sum(axis=1, keepdims=True)
        if not np.isfinite(matrix).all() or np.abs(matrix).max() > 50.0:
            raise ValueError("the colour matrices are no basis")
        return np.asarray(matrix, np.float64)

    def _from_xyz(self, white: tuple[float, float]) -> Matrix:
        return np.asarray(self._mixed(self.own, white) @ self._mixed(self.color, white))

    def _mixed(self, matrices: tuple[Matrix, ...], white: tuple[float, float]) -> Matrix:
        """Interpolation in inverse temperature between the illuminants, clamped to them."""
        if len(matrices) == 1:
            return matrices[0]
        first, second = (1.0 / kelvin for kelvin in self.kelvin)
        share = np.clip((1.0 / temperature(white) - second) / (first - second), 0.0, 1.0)
        return np.asarray(share * matrices[0] + (1.0 - share) * matrices[1])


def temperature(white: tuple[float, float]) -> float:
    """Correlated colour temperature of (x, y) in kelvin [mccamy1992], clamped to [1500, 50000]."""
    n = (white[0] - 0.3320) / (0.1858 - white[1])
    return float(np.clip(((449.0 * n + 3525.0) * n + 6823.3) * n + 5520.33, 1500.0, 50_000.0))


def _matrix(tags: Tags, tag: int) -> Matrix | None:
    values = finite_numbers(tags, tag, 9)
    return None if values is None or not values.any() else values.reshape(3, 3)


def _text(tags: Tags, tag: int) -> bytes:
    value = tags[tag].value if tag in tags else b""
    return (value.encode() if isinstance(value, str) else bytes(value)).rstrip(b"\0")


@dataclass(frozen=True)
class Corrections:
    """Corrections of a DNG that matcap applies itself."""

    on_mosaic: Opcodes = Opcodes()
    """OpcodeList2, for linear samples before demosaicing."""
    after_demosaic: Opcodes = Opcodes()
    """OpcodeList3."""
    samples: Literal["plain", "packed", "misread", "floating"] = "plain"
    """Whole numbers that LibRaw reads, cannot read (JPEG XL) or misreads; or floating point."""
    crop: raw_samples.Crop | None = None
    """Part of the active area that is the picture; None is all of it."""
    active_area: tuple[int, int, int, int] | None = None
    """Top, left, bottom, right (the last two excluded) of the area that gain maps refer to, in the
    stored picture; None is all of it."""
    color: DngColor | None = None
    """White balance and colour matrix, or None if the file has no matrix."""
    notes: tuple[str, ...] = ()
    """Notes on corrections that are not applied."""

    @property
    def has_maps(self) -> bool:
        """Whether there are gain maps."""
        return bool(self.on_mosaic.gain_maps or self.after_demosaic.gain_maps)


def read_corrections(path: Path) -> Corrections:
    """Read a DNG's opcode lists, colour tags and compression.

    Raises:
        MatcapError: the tags or the gain maps are damaged. Ignoring them would attribute lens
            shading to the light, or the light's colour to the material.
    """
    import tifffile

    with decoding(path, "DNG"), tifffile.TiffFile(path) as file:
        page = raw_samples.raw_page(file)
        if page is None:
            return Corrections()
        check_size(path, page.imagewidth, page.imagelength)  # LibRaw calls small ones damaged
        pattern = raw_samples.unsupported_pattern(page)
        if pattern and int(page.photometric) == raw_samples.CFA:
            raise unsupported(path, f"a DNG whose mosaic repeats by {pattern} photosites")
        # A list without entries where the tag is absent.
        before, after = (
            parse_opcodes(bytes(page.tags[tag].value) if tag in page.tags else bytes(4))
            for tag in (Tag.OpcodeList2, Tag.OpcodeList3)
        )
        samples: Literal["plain", "packed", "misread", "floating"] = "plain"
        if int(page.sampleformat) == raw_samples.FLOATING:
            samples = "floating"
        elif raw_samples.needs_normalising(page, bool(before.value_maps)):
            samples = "misread"
        elif int(page.compression) == raw_samples.JPEG_XL:
            samples = "packed"
        of_file = file.pages.first.tags
        tags = {tag.code: tag for one in (of_file, page.tags) for tag in one}
        area, crop = _active_area(page), raw_samples.crop_of(page, tags)
        asked = sorted((before.changes - {VALUE_MAPPING}) | after.changes)
        notes = [f"The DNG asks for {what}, which was not applied." for what in asked]
        if crop is not None and not crop.centred:
            notes.append(
                "The file's crop is off centre: the smallest part around the centre that holds it "
                "is read."
            )
        stated = {tag.code: tag for one in (page.tags, of_file) for tag in one}
        return Corrections(
            before,
            after,
            samples,
            crop,
            None if samples == "misread" else area,
            dng_color(stated),
            tuple(notes),
        )


def _active_area(page: raw_samples.TiffPage) -> tuple[int, int, int, int] | None:
    if Tag.ActiveArea not in page.tags:
        return None
    top, left, bottom, right = (int(edge) for edge in page.tags[Tag.ActiveArea].value)
    if not (0 <= top < bottom <= page.imagelength and 0 <= left < right <= page.imagewidth):
        raise ValueError("the active area lies outside the picture")
    return top, left, bottom, right


def read_float_dng(
    path: Path, long_side: int | None, corrections: Corrections, white: float | None
) -> Decoded:
    """Read a DNG whose raw picture is in floating point, as merged exposures are.

    LibRaw scales such a picture by its maximum. A mosaic is averaged by 2 x 2. White balance,
    colours, active area and crop are the file's.

    Raises:
        MatcapError: truncated, damaged, too small, with lens-shading maps, of another pattern than
            2 x 2, or without a colour matrix.
    """
    import tifffile

    color, crop = corrections.color, corrections.crop
    if color is None or corrections.has_maps:
        raise unsupported(path, "a float DNG without a colour matrix, or with gain maps")
    with decoding(path, "DNG"), tifffile.TiffFile(path) as file:
        page: raw_samples.TiffPage = raw_samples.raw_page(file)
        if int(page.compression) != 1:
            raw_samples.check_codecs(path)
        samples = raw_samples.normalised(page)
        pattern = bytes(page.tags[Tag.CFAPattern].value) if samples.ndim == 2 else None
    camera = samples[..., :3] if pattern is None else _binned(path, samples, pattern)
    size, whole = (samples.shape[1], samples.shape[0]), None
    if crop is not None:
        step = 1 if pattern is None else 2
        top, left, bottom, right = (edge // step for edge in crop.shown)
        camera = camera[top:bottom, left:right]
        size, whole = crop.sizes
    balanced = np.asarray(camera / np.array(color.neutral, np.float32), np.float32)
    notes = (*corrections.notes, *((color.note,) if color.note else ()))
    space = ColorSpace("the camera", LINEAR.curves, color.matrix)
    coded = replace(light(path, balanced, white, notes), color=StatedColor(space=space))
    red, green, blue = (1.0 / channel for channel in color.neutral)
    picture = decode(coded, long_side)
    balance = (red, green, blue)
    photo = replace(picture.photo, original_size=size, radiometric=True, balance=balance)
    return replace(picture, photo=photo, whole=whole)


def _binned(path: Path, samples: NDArray[np.float32], pattern: bytes) -> NDArray[np.float32]:
    """(H / 2, W / 2, 3) means of each colour over the 2 x 2 photosites of a mosaic."""
    if sorted(pattern) != [0, 1, 1, 2]:
        raise unsupported(path, "a float DNG whose mosaic is not of 2 x 2 photosites")
    height, width = (side // 2 * 2 for side in samples.shape)
    samples = samples[:height, :width].copy()
    raw_samples.centre_colours(samples, np.reshape(list(pattern), (2, 2)))
    sites = [samples[row::2, column::2] for row in (0, 1) for column in (0, 1)]
    planes = [
        np.mean([s for s, of in zip(sites, pattern, strict=True) if of == c], axis=0)
        for c in range(3)
    ]
    return np.stack(planes, axis=-1)
