"""Calibration of a series of photographs from one of a calibration card.

From a ChArUco board (examples/card.pdf): millimetres per plane unit, and the card's tilt. From a
ColorChecker Classic in a RAW: a matrix to true colours, and the radiance of white under this flash,
which makes albedo absolute. Both hold for photographs from the same distance; differences of
exposure are compensated by Exif. The flash's falloff over the chart is fitted as a smooth factor.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.color import srgb_decode, srgb_encode
from matcap.photo.exif import read_exif
from matcap.photo.load import load_photo
from matcap.photo.photo import Photo

Values = NDArray[np.float64]

# The card of examples/card.pdf, in millimetres from its page's upper left corner: a ChArUco board,
# and patches arranged as on a ColorChecker Classic, with its published sRGB values (X-Rite, D65,
# before November 2014).
_SQUARES = (7, 5)  # of the board
_SQUARE, _MARKER = 24.0, 18.0  # mm, sides
_BOARD_AT = (21.0, 24.0)
_PATCHES_AT, _PATCHES_SIZE = (24.5, 158.0), (153.0, 101.0)

# sRGB, row by row from dark skin to black.
PATCHES = (
    (115, 82, 68), (194, 150, 130), (98, 122, 157), (87, 108, 67), (133, 128, 177), (103, 189, 170),
    (214, 126, 44), (80, 91, 166), (193, 90, 99), (94, 60, 108), (157, 188, 64), (224, 163, 46),
    (56, 61, 150), (70, 148, 73), (175, 54, 60), (231, 199, 31), (187, 86, 149), (8, 133, 161),
    (243, 243, 242), (200, 200, 200), (160, 160, 160), (122, 122, 121), (85, 85, 85), (52, 52, 52),
)  # fmt: skip

_WIDTH = 2048  # pixels across at which cards are detected
_LEAST_CORNERS = 6  # of the board; a homography needs four
_ROUGH_ROUNDS = 6  # of fit_patches during the search for the chart's corners
_MOVES = 60  # random moves of the corners in that search
_MOST_CLIPPED = 0.02  # share of clipped samples in patches
_GAP = 0.15  # between patches of a ColorChecker in OpenCV's box, in patch sides
_INSIDE = 0.25  # half width of the measured square of a patch, in patch sides
_WORST_FIT = 0.12  # largest relative RMS residual of a ColorChecker


@dataclass(frozen=True)
class Calibration:
    """Calibration by one photograph of a card."""

    card: str
    """Name of the photograph."""
    digest: str
    """Hash of all other fields; part of a material's identity."""
    millimetres_per_unit: float | None = None
    """Length of a plane unit, half the photographed rectangle's long side; or None."""
    tilt: float | None = None
    """Tilt of the card, degrees, or None."""
    matrix: tuple[tuple[float, ...], ...] | None = None
    """(3, 3) from the photographs' linear colours to true colours, by rows; or None."""
    white: float | None = None
    """Radiance of a white diffuser in the middle of the photograph, in units of the clip level at
    the card's exposure, after the matrix; or None."""
    exposure: float | None = None
    """Exposure of the card's photograph, as Exif.exposure, or None."""
    residual: float | None = None
    """Relative RMS residual of the patches, or None."""

    def document(self) -> dict[str, Any]:
        """The calibration for JSON."""
        return {
            "card": self.card,
            "millimetres_per_unit": self.millimetres_per_unit,
            "card_tilt_degrees": self.tilt,
            "colour_matrix": self.matrix,
            "white": self.white,
            "residual": self.residual,
        }


def read_card(path: Path, *, fov: float | None = None) -> Calibration:
    """Calibrate by the board and the chart in a photograph.

    Args:
        fov: degrees across the long side; None is the file's.

    Raises:
        MatcapError: the photograph cannot be read, or shows neither board nor chart.
    """
    photo = load_photo(path, long_side=_WIDTH, fov=fov, noise=False)
    code = (srgb_encode(np.clip(photo.pixels, 0.0, 1.0).astype(np.float64)) * 255.0).round()
    picture = code.astype(np.uint8)
    calibration = Calibration(photo.name, "")
    seen = _board(picture)
    if seen is not None:
        scale, tilt = _pose(*seen, picture.shape, photo.fov)
        calibration = replace(calibration, millimetres_per_unit=scale, tilt=tilt)
    fit = _best_chart(picture, photo, seen) if photo.radiometric else None
    if fit is not None:
        calibration = replace(
            calibration,
            matrix=tuple(tuple(float(v) for v in row) for row in fit.matrix),
            white=fit.white,
            exposure=read_exif(path).exposure,
            residual=fit.residual,
        )
    if seen is None and fit is None:
        raise MatcapError.at(
            path,
            "no card is seen here, neither a ChArUco board nor, in a RAW, a ColorChecker",
            "photograph the card whole and sharp, or remove this photograph from the folder",
        )
    return replace(calibration, digest=hashlib.sha256(repr(calibration).encode()).hexdigest())


def calibrated(photo: Photo, calibration: Calibration) -> Photo:
    """Apply a calibration to a RAW photograph: true colours, and the flash's radiant intensity.

    The intensity needs both photographs' exposures. Developed photographs are returned unchanged.
    """
    if calibration.matrix is None or not photo.radiometric:
        return photo
    matrix = np.array(calibration.matrix, np.float32)
    noise = None if photo.noise is None else photo.noise @ matrix.T
    photo = replace(photo, pixels=np.maximum(photo.pixels @ matrix.T, 0.0), noise=noise)
    exposure, white = photo.exposure, calibration.white
    if white is None or exposure is None or calibration.exposure is None:
        return photo
    # The radiance of white in the middle is I / (pi d^2).
    distance = 1.0 / math.tan(math.radians(photo.fov) / 2.0)
    flash = math.pi * distance**2 * white * exposure / calibration.exposure
    return replace(photo, flash_intensity=flash)


@dataclass(frozen=True)
class ChartFit:
    """Fit of a chart's patches."""

    matrix: Values
    """(3, 3) from measured to true colours, which keeps the mean radiance of white."""
    white: float
    """Radiance of white in the middle of the picture, mean of the channels."""
    residual: float
    """Relative RMS residual of the patches."""


def fit_patches(measured: Values, places: Values, rounds: int = 100) -> ChartFit:
    """Fit response and falloff to the 24 patches of a ColorChecker.

    measured = falloff(x, y) * response @ true, with falloff = exp(a x + b y + c (x^2 + y^2)), by
    alternating least squares of relative errors.

    Args:
        measured: (24, 3) linear colours.
        places: (24, 2) image coordinates x, y, 0 in the middle.
        rounds: iterations; a few suffice to distinguish charts from other patterns.
    """
    true = srgb_decode(np.array(PATCHES) / 255.0)
    x, y = places[:, 0], places[:, 1]
    terms = np.stack([x, y, x * x + y * y], axis=1)
    falloff = np.ones(len(measured))
    weight = 1.0 / (measured.mean(axis=1) + 0.02 * measured.mean())
    response = np.eye(3)
    for _ in range(rounds):
        known = true * (falloff * weight)[:, None]
        response = np.linalg.lstsq(known, measured * weight[:, None], rcond=None)[0].T
        ideal = np.maximum((true @ response.T).sum(axis=1), 1e-9)
        ratio = np.log(np.maximum(measured.sum(axis=1), 1e-9) / ideal)
        falloff = np.exp(terms @ np.linalg.lstsq(terms, ratio, rcond=None)[0])
    rest = (measured - falloff[:, None] * (true @ response.T)) * weight[:, None]
    residual = float(np.sqrt(np.mean(rest**2)))
    if abs(np.linalg.det(response)) < 1e-9:
        return ChartFit(np.eye(3), 1.0, math.inf)
    white = float(response.sum(axis=1).mean())  # the response to (1, 1, 1)
    return ChartFit(np.asarray(np.linalg.inv(response) * white), white, residual)


_Board = tuple[Values, Values]  # (N, 2) corners in the picture, (N, 3) on the card in millimetres


def _board(picture: NDArray[np.uint8]) -> _Board | None:
    """Detect the corners of a ChArUco board; None if there is none."""
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    pattern = cv2.aruco.CharucoBoard(_SQUARES, _SQUARE, _MARKER, dictionary)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(pattern).detectBoard(grey)
    if ids is None or len(ids) < _LEAST_CORNERS:
        return None
    on_card = np.asarray(pattern.getChessboardCorners(), np.float64)[ids.ravel()]
    return corners.reshape(-1, 2).astype(np.float64), on_card


def _pose(corners: Values, on_card: Values, shape: Any, fov: float) -> tuple[float, float]:  # noqa: ANN401
    """(millimetres per plane unit, tilt in degrees) from a board's corners."""
    height, width = shape[:2]
    focal = width / 2.0 / math.tan(math.radians(fov) / 2.0)
    camera = np.array([[focal, 0, width / 2 - 0.5], [0, focal, height / 2 - 0.5], [0, 0, 1.0]])
    _, turn, shift = cv2.solvePnP(on_card, corners, camera, None)
    normal = cv2.Rodrigues(turn)[0][:, 2]
    # Distance along the optical axis.
    distance = abs(float(normal @ shift.ravel() / normal[2]))
    tilt = math.degrees(math.acos(min(1.0, abs(float(normal[2])))))
    return distance * math.tan(math.radians(fov) / 2.0), tilt


def _best_chart(picture: NDArray[np.uint8], photo: Photo, seen: _Board | None) -> ChartFit | None:
    """The best fit among OpenCV's candidates of a chart, each refined; None if none is good."""
    fits = (_settled(box, photo) for box in _boxes(picture, seen))
    good = [fit for fit in fits if fit is not None and fit.residual < _WORST_FIT]
    return min(good, key=lambda fit: fit.residual, default=None)


def _boxes(picture: NDArray[np.uint8], seen: _Board | None) -> Iterator[Values]:
    """Candidate boxes of charts: four corners (4, 2), from the dark skin patch clockwise."""
    shown = picture[..., ::-1].copy()
    if seen is not None:
        card = cv2.findHomography(seen[1], seen[0])[0]
        (x, y), (width, height) = _PATCHES_AT, _PATCHES_SIZE
        corners = [[x, y], [x + width, y], [x + width, y + height], [x, y + height]]
        # Board coordinates begin at the board's corner, not at the page's.
        own = np.array([corners], np.float64) - np.array(_BOARD_AT)
        yield cv2.perspectiveTransform(own, card)[0]
        hull = cv2.convexHull(seen[0].astype(np.float32)).reshape(-1, 2)
        middle = hull.mean(axis=0)
        around = (middle + 1.5 * (hull - middle)).astype(np.int32)
        cv2.fillConvexPoly(shown, around, (128, 128, 128))  # its squares resemble patches
    blurred = cv2.GaussianBlur(shown, (0, 0), 1.0)
    for scale, version in ((1.0, shown), (1.0, blurred), (0.6, blurred), (1.6, blurred)):
        sized = cv2.resize(version, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        detector = cv2.mcc.CCheckerDetector.create()
        detector.setColorChartType(cv2.mcc.MCC24)
        try:
            detected = detector.process(np.ascontiguousarray(sized), 3)
        except cv2.error:
            continue
        for checker in detector.getListColorChecker() if detected else ():
            yield np.asarray(checker.getBox(), np.float64) / scale


def _settled(box: Values, photo: Photo) -> ChartFit | None:
    """The best fit near a box, by random moves of its corners of decreasing size."""
    chance = np.random.default_rng(0)
    side = float(np.linalg.norm(box[1] - box[0])) / 6.0
    best: ChartFit | None = None
    for step in range(_MOVES):
        reach = 0.0 if step == 0 else 0.35 * side * (1.0 - step / _MOVES)
        moved = box + chance.normal(0.0, 1.0, box.shape) * reach
        patches = _patches(moved, photo)
        if patches is None:
            continue
        fit = fit_patches(*patches, rounds=_ROUGH_ROUNDS)
        if best is None or fit.residual < best.residual:
            best, box = fit, moved
    patches = _patches(box, photo)
    return None if best is None or patches is None else fit_patches(*patches)


def _patches(box: Values, photo: Photo) -> tuple[Values, Values] | None:
    """(24, 3) median colours of a box's patches and their (24, 2) positions; None if clipped."""
    steps = 1.0 + _GAP
    width, height = 6 + 5 * _GAP, 4 + 3 * _GAP
    flat = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    warp = cv2.getPerspectiveTransform(flat, box.astype(np.float32))
    around = np.linspace(-_INSIDE, _INSIDE, 7)
    middles = np.array([[c * steps + 0.5, r * steps + 0.5] for r in range(4) for c in range(6)])
    offsets = np.array([[dx, dy] for dy in around for dx in around])
    seen = cv2.perspectiveTransform((middles[:, None] + offsets).reshape(1, -1, 2), warp)[0]
    rows, columns = photo.pixels.shape[:2]
    at = np.clip(seen.round(), 0, [columns - 1, rows - 1]).astype(int)
    if photo.clipped[at[:, 1], at[:, 0]].mean() > _MOST_CLIPPED:
        return None
    colours = photo.pixels[at[:, 1], at[:, 0]].reshape(24, -1, 3).astype(np.float64)
    centres = (seen.reshape(24, -1, 2).mean(axis=1) - [columns / 2, rows / 2]) / (columns / 2)
    # The median is robust against a patch's border.
    return np.median(colours, axis=1), centres * [1.0, -1.0]


def card_sentence(calibration: Calibration | None) -> str:
    """The calibration as a sentence for the user."""
    if calibration is None:
        return "No card: albedo is relative, lengths are in parts of the photograph."
    sentences = [f"Card {calibration.card}:"]
    if calibration.millimetres_per_unit is not None:
        sentences.append(f"{calibration.millimetres_per_unit:.1f} mm a unit at its distance,")
        sentences.append(f"seen at {calibration.tilt:.1f} degrees;")
    else:
        sentences.append(f"no board of {_SQUARE:g} mm squares, so no millimetres;")
    if calibration.matrix is None:
        sentences.append("no ColorChecker in a RAW, so albedo is relative.")
    else:
        sentences.append(
            f"colours within {100.0 * (calibration.residual or 0.0):.1f} %, albedo absolute."
        )
    return " ".join(sentences)
