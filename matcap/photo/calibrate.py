"""Calibration of a shoot from a photograph of the printed card.

From a ChArUco board (matcap card): millimetres a plane unit, and how squarely the card was seen.
From a ColorChecker Classic in a RAW: a matrix to true colours, and how bright a white surface is
under this flash at this exposure, which makes albedo absolute. Both hold for photographs from the
same distance with the same exposure; exposure is compared by Exif.

The flash's falloff over the chart is fitted with it, as a smooth factor.
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
from matcap.files.srgb import srgb_decode, srgb_encode
from matcap.photo.card import BOARD_AT, PATCHES, PATCHES_AT, PATCHES_SIZE, SQUARE, board
from matcap.photo.exif import read_exif
from matcap.photo.load import load_photo
from matcap.photo.photo import Photo

Values = NDArray[np.float64]

_WIDTH = 2048  # pixels across that cards are looked for at
_LEAST_CORNERS = 6  # of the board; a homography needs four
_ROUGH_ROUNDS = 6  # of fit_patches, while patches are still looked for
_MOVES = 60  # of the patches, each nearer than the last
_MOST_CLIPPED = 0.02  # share of the places looked at
# A ColorChecker's grid as OpenCV's box around it: patches and gaps, in patch sides.
_GAP = 0.15
_INSIDE = 0.25  # of a patch's side around its middle that is measured, either way
_WORST_FIT = 0.12  # root-mean-square relative residual beyond which it is no ColorChecker


@dataclass(frozen=True)
class Calibration:
    """What was learnt from one card.

    Attributes:
        card: the photograph's name.
        digest: of all of it; part of a material's identity.
        millimetres_per_unit: half the long side of the photographed rectangle, or None.
        tilt: degrees that the card was seen at, or None.
        matrix: (3, 3) from the photographs' linear colours to true ones, rows; or None.
        white: radiance of a white diffuser squarely under the flash, in parts of the clip level at
            the card's exposure, after the matrix; or None.
        exposure: of the card's photograph, in relative units, or None where Exif lacks it.
        residual: relative root-mean-square error of the patches, or None.
    """

    card: str
    digest: str
    millimetres_per_unit: float | None = None
    tilt: float | None = None
    matrix: tuple[tuple[float, ...], ...] | None = None
    white: float | None = None
    exposure: float | None = None
    residual: float | None = None

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "card": self.card,
            "millimetres_per_unit": self.millimetres_per_unit,
            "card_tilt_degrees": self.tilt,
            "colour_matrix": self.matrix,
            "white": self.white,
            "residual": self.residual,
        }


def read_card(path: Path, *, fov: float | None = None) -> Calibration:
    """Find a board and a chart in a photograph of a card.

    Args:
        path: the photograph.
        fov: degrees across the long side; by default the file's.

    Raises:
        MatcapError: it cannot be read, or shows neither.
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
        raise MatcapError(
            "no card is seen here, neither a ChArUco board nor, in a RAW, a ColorChecker",
            where=str(path),
            remedy="photograph the card whole and sharp, or take the photograph out of the shoot",
        )
    digest = hashlib.sha256(repr(calibration).encode()).hexdigest()
    return replace(calibration, digest=digest)


def calibrated(photo: Photo, calibration: Calibration) -> Photo:
    """A photograph in true colours, and with its flash known where the exposures can be compared.

    Only RAWs change: a developed picture's numbers are no light.
    """
    if calibration.matrix is None or not photo.radiometric:
        return photo
    matrix = np.array(calibration.matrix, np.float32)
    noise = None if photo.noise is None else photo.noise @ matrix.T
    photo = replace(photo, pixels=np.maximum(photo.pixels @ matrix.T, 0.0), noise=noise)
    exposure, white = photo.exposure, calibration.white
    if white is None or exposure is None or calibration.exposure is None:
        return photo
    # White reflects I / (pi d^2) where it lies squarely under the flash.
    distance = 1.0 / math.tan(math.radians(photo.fov) / 2.0)
    flash = math.pi * distance**2 * white * exposure / calibration.exposure
    return replace(photo, flash_intensity=flash)


@dataclass(frozen=True)
class ChartFit:
    """What the patches of a chart say.

    Attributes:
        matrix: (3, 3) measured to true colours, white kept as bright as it is.
        white: radiance of white in the middle of the picture, mean of the channels.
        residual: relative root-mean-square error of the patches.
    """

    matrix: Values
    white: float
    residual: float


def fit_patches(measured: Values, places: Values, rounds: int = 100) -> ChartFit:
    """Colours and falloff from the 24 patches of a ColorChecker.

    measured = falloff(place) * response @ true, by alternating least squares; falloff is the
    exponential of a quadratic that is 0 in the middle of the picture.

    Args:
        measured: (24, 3) linear.
        places: (24, 2) image coordinates, the middle at 0.
        rounds: of the alternation; a few distinguish charts from other patterns.
    """
    true = srgb_decode(np.array(PATCHES) / 255.0)
    x, y = places[:, 0], places[:, 1]
    terms = np.stack([x, y, x * x + y * y], axis=1)
    falloff = np.ones(len(measured))
    weight = 1.0 / (measured.mean(axis=1) + 0.02 * measured.mean())  # relative errors count
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


_Board = tuple[Values, Values]  # corners in the picture, and on the card in millimetres


def _board(picture: NDArray[np.uint8]) -> _Board | None:
    """The corners of a ChArUco board; None where there is none."""
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    pattern = board()
    corners, ids, _, _ = cv2.aruco.CharucoDetector(pattern).detectBoard(grey)
    if ids is None or len(ids) < _LEAST_CORNERS:
        return None
    on_card = np.asarray(pattern.getChessboardCorners(), np.float64)[ids.ravel()]
    return corners.reshape(-1, 2).astype(np.float64), on_card


def _pose(corners: Values, on_card: Values, shape: Any, fov: float) -> tuple[float, float]:  # noqa: ANN401
    """(millimetres a plane unit, tilt in degrees) of a board."""
    height, width = shape[:2]
    focal = width / 2.0 / math.tan(math.radians(fov) / 2.0)
    camera = np.array([[focal, 0, width / 2 - 0.5], [0, focal, height / 2 - 0.5], [0, 0, 1.0]])
    _, turn, shift = cv2.solvePnP(on_card, corners, camera, None)
    normal = cv2.Rodrigues(turn)[0][:, 2]
    # Where the middle of the picture meets the card.
    distance = abs(float(normal @ shift.ravel() / normal[2]))
    tilt = math.degrees(math.acos(min(1.0, abs(float(normal[2])))))
    return distance * math.tan(math.radians(fov) / 2.0), tilt


def _best_chart(picture: NDArray[np.uint8], photo: Photo, seen: _Board | None) -> ChartFit | None:
    """The chart whose patches fit best, among all that OpenCV takes for one; None if none does.

    Its boxes are rough, and some are no charts: each is moved about until the colours fit.
    """
    best: ChartFit | None = None
    for box in _boxes(picture, seen):
        fit = _settled(box, photo)
        if fit is not None and fit.residual < _WORST_FIT:
            best = fit if best is None or fit.residual < best.residual else best
    return best


def _boxes(picture: NDArray[np.uint8], seen: _Board | None) -> Iterator[Values]:
    """Where charts may be: four corners, from dark skin clockwise."""
    shown = picture[..., ::-1].copy()
    if seen is not None:
        card = cv2.findHomography(seen[1], seen[0])[0]
        (x, y), (width, height) = PATCHES_AT, PATCHES_SIZE
        corners = [[x, y], [x + width, y], [x + width, y + height], [x, y + height]]
        # Corners of the board count from its own, not from the page's.
        own = np.array([corners], np.float64) - np.array(BOARD_AT)
        yield cv2.perspectiveTransform(own, card)[0]
        hull = cv2.convexHull(seen[0].astype(np.float32)).reshape(-1, 2)
        middle = hull.mean(axis=0)
        around = (middle + 1.5 * (hull - middle)).astype(np.int32)
        cv2.fillConvexPoly(shown, around, (128, 128, 128))  # its squares look like patches
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
    """The best fit near a box, corners moved at random by less and less."""
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
    """(24, 3) linear patch colours and their (24, 2) places; None where they are burnt out."""
    steps = 1.0 + _GAP
    width, height = 6 + 5 * _GAP, 4 + 3 * _GAP
    flat = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    warp = cv2.getPerspectiveTransform(flat, box.astype(np.float32))
    around = np.linspace(-_INSIDE, _INSIDE, 7)
    middles = np.array([[c * steps + 0.5, r * steps + 0.5] for r in range(4) for c in range(6)])
    offsets = np.array([[dx, dy] for dy in around for dx in around])
    spots = (middles[:, None] + offsets).reshape(1, -1, 2)
    seen = cv2.perspectiveTransform(spots, warp)[0]
    rows, columns = photo.pixels.shape[:2]
    at = np.clip(seen.round(), 0, [columns - 1, rows - 1]).astype(int)
    if photo.clipped[at[:, 1], at[:, 0]].mean() > _MOST_CLIPPED:
        return None
    colours = photo.pixels[at[:, 1], at[:, 0]].reshape(24, -1, 3).astype(np.float64)
    centres = (seen.reshape(24, -1, 2).mean(axis=1) - [columns / 2, rows / 2]) / (columns / 2)
    # Patches are even: what varies inside one is its border.
    return np.median(colours, axis=1), centres * [1.0, -1.0]


def card_sentence(calibration: Calibration | None) -> str:
    """What holds for a shoot, in words."""
    if calibration is None:
        return "No card: albedo is relative, lengths are in parts of the photograph."
    said = [f"Card {calibration.card}:"]
    if calibration.millimetres_per_unit is not None:
        said.append(f"{calibration.millimetres_per_unit:.1f} mm a unit at its distance,")
        said.append(f"seen at {calibration.tilt:.1f} degrees;")
    else:
        said.append(f"no board of {SQUARE:g} mm squares, so no millimetres;")
    if calibration.matrix is None:
        said.append("no ColorChecker in a RAW, so albedo is relative.")
    else:
        said.append(f"colours within {calibration.residual:.1%}, albedo absolute.")
    return " ".join(said)
