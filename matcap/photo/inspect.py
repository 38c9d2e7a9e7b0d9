"""Quality checks of a photograph before capture, with advice for the next shot.

The tilt is an argument, as it is from the coarse fit of a capture. Positions and directions in
findings are of the upright photograph (_upright). The measures are verified on simulated
photographs (tests/photo).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.photo.checks import CHECKS, Finding, Rating, Region
from matcap.photo.hdr_gain_map import NAME as GAIN_MAP
from matcap.photo.left_out import area_averaged, border_crop, cell_means
from matcap.photo.photo import Photo

Values = NDArray[np.float64]

# Constants of the measures; docs/notes/verdict.md. Limits are in checks.py.
_TOE = 0.02  # added inside logarithms, as a share of the median
# Share of a pixel's brightness added to its channels before hues: the darkest channel of a
# saturated JPEG is rounding, of which hues of their own would be made.
_GREY = 0.03
_HOT_CELLS = 128  # cells across in which the hot spot is searched
_HOT_BLUR = 0.08  # standard deviation of the blur before the maximum is taken, share of the width
# Standard deviation of the Gaussian window of the paraboloid's fit around the hot spot, share of
# the width.
_HOT_REACH = 0.14
_HOT_ROUNDS = 4  # iterations of that fit
_SHARP = 1024  # most pixels across at which sharpness is measured, whatever is read
_SHARPEST = 0.25  # quantile over tiles of the blur, as smooth parts do not show the focus
_LEAST_DETAIL = 1e-5  # least squared gradient of log radiance, per pixel, of a tile with detail
# Usual differences between tiles: log contrast of a fine and of a coarser band, and two log hues.
_USUAL = (0.4, 0.6, 0.15, 0.15)
_FLASH_TERMS = 5  # functions of the distance from the hot spot
_TILES = 8  # along the long side
# A picture without a material: pixels across that are too few, share of pixels equal to others,
# deviation of log radiance in fine texture below which there is none, difference between parts.
_SMALL, _EQUAL, _BLANK, _MIXED = 256, 0.4, 0.008, 2.4
# Radiance of the tenth of 255 codes, below which smooth black is equal, and the most below it.
_TENTH, _BLACK = 3e-3, 0.95
_SEPARATION = 32  # how far from others, as a share of the longer side
_NOT_ONE = 9.0  # severity of such a picture, above those of what is wrong with a material's
_CELLS = 4.0  # cells of the coarser grid of a wide blur to its deviation


@dataclass(frozen=True)
class Inspection:
    """All findings of a photograph, in order of importance."""

    name: str
    findings: tuple[Finding, ...]

    @property
    def rating(self) -> Rating:
        """The worst rating of the findings that are rated."""
        rated = [f.rating for f in self.findings if f.rating is not Rating.NOT_JUDGED]
        return max(rated, key=list(Rating).index, default=Rating.GOOD)

    def __getitem__(self, name: str) -> Finding:
        return next(finding for finding in self.findings if finding.name == name)

    def with_finding(self, finding: Finding) -> Inspection:
        """The inspection with a finding in place of the one of its name, or at the end."""
        known = {one.name: one for one in self.findings} | {finding.name: finding}
        return replace(self, findings=tuple(known.values()))

    def document(self) -> dict[str, Any]:
        """The inspection for JSON."""
        return {
            "name": self.name,
            "rating": self.rating.value,
            **{finding.name: finding.document() for finding in self.findings},
        }


def inspect_photo(photo: Photo, tilt: tuple[float, float] | None = None) -> Inspection:
    """Check a photograph, in a fraction of a second.

    Args:
        photo: at the resolution of the capture, which sharpness depends on.
        tilt: (tilt_x, tilt_y) of the coarse fit, radians, or None.
    """
    place, falloff = hot_spot(photo)
    tiles = unevenness(photo.pixels, place)
    return Inspection(
        photo.name,
        (
            _subject(photo, tiles, falloff),
            _flash(photo, falloff),
            CHECKS["clipped"].finding(photo.clipped_share),
            _hot_spot(photo, place),
            _tilt(photo, tilt),
            _sharpness(photo),
            _stationarity(photo, tiles),
            _radiometric(photo),
            *_reading(photo),
            *_border(photo),
        ),
    )


def hot_spot(photo: Photo) -> tuple[tuple[float, float], float]:
    """Position and contrast of the hot spot, the brightest place.

    The maximum of the blurred log radiance is refined to the vertex of a paraboloid, fitted to log
    radiance around it.

    Returns:
        (x, y) in shares of the width and height of photo.pixels, from the upper left; and the ratio
        of the blurred radiance there to the median along the border.
    """
    light = _log(cell_means(photo.pixels, _HOT_CELLS).astype(np.float64).mean(axis=-1))
    height, width = light.shape
    smooth = cv2.GaussianBlur(light, (0, 0), _HOT_BLUR * width)
    row, column = np.unravel_index(int(smooth.argmax()), smooth.shape)
    y, x = float(row), float(column)
    rows, columns = np.mgrid[:height, :width].astype(np.float64)
    for _ in range(_HOT_ROUNDS):
        u, v = (columns - x) / width, (rows - y) / width
        weight = np.exp(-(u**2 + v**2) / (4.0 * _HOT_REACH**2)).ravel()  # root of a Gaussian's
        terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1).reshape(-1, 6)
        c = np.linalg.lstsq(terms * weight[:, None], light.ravel() * weight, rcond=None)[0]
        bend = np.array([[2.0 * c[3], c[4]], [c[4], 2.0 * c[5]]])
        if np.linalg.eigvalsh(bend)[-1] >= -1e-6:
            break  # not a maximum: keep the present position
        step = np.clip(-width * np.linalg.solve(bend, c[1:3]), -0.1 * width, 0.1 * width)
        x = float(np.clip(x + step[0], 0.0, width - 1.0))
        y = float(np.clip(y + step[1], 0.0, height - 1.0))
    rim = np.concatenate([smooth[0], smooth[-1], smooth[:, 0], smooth[:, -1]])
    ratio = math.exp(float(smooth.max()) - float(np.median(rim)))
    return ((x + 0.5) / width, (y + 0.5) / height), ratio


def softness(pixels: NDArray[np.float32]) -> float:
    """Blur of the sharper parts of a picture, a Gaussian's standard deviation in pixels.

    NaN if there is no detail. For a texture with equal gradient energy at all scales, blur b leaves
    an energy at scale s proportional to 1 / (b^2 + s^2); it is computed from s = 1 and 2.
    """
    light = _log(channel_mean(pixels))
    one, two = (_tiles(_gradient_energy(light, scale)) for scale in (1.0, 2.0))
    if float(np.quantile(one, 1.0 - _SHARPEST)) < _LEAST_DETAIL:
        return math.nan
    ratio = np.clip(two / np.maximum(one, 1e-12), 0.0, 0.99)
    blur = np.sqrt(np.maximum(4.0 * ratio - 1.0, 0.0) / (1.0 - ratio))
    return float(np.quantile(blur, _SHARPEST))


def unevenness(pixels: NDArray[np.float32], place: tuple[float, float]) -> Values:
    """(rows, columns) difference of tiles from a uniform material, in units of _USUAL.

    Root sum of squares over the log contrast in two bands and two log hues, each less its
    regression on the flash: on hat functions of the distance from the hot spot, of hues also on
    log luminance.

    Args:
        pixels: (H, W, 3) linear.
        place: of the hot spot, from hot_spot.
    """
    mean = channel_mean(pixels)
    light, colour = _log(mean), _log(pixels + _GREY * mean[..., None])
    width = light.shape[1]
    fine, middle = (blurred(light, width / s) for s in (128.0, 32.0))
    measures = [
        0.5 * np.log(_tiles((light - fine) ** 2) + 1e-6),
        0.5 * np.log(_tiles((fine - middle) ** 2) + 1e-6),
        _tiles(colour[..., 0] - colour[..., 1]),
        _tiles(colour[..., 2] - colour[..., 1]),
    ]
    rows, columns = measures[0].shape
    y, x = np.mgrid[:rows, :columns].astype(np.float64)
    across = (x + 0.5) / columns - place[0]
    distance = np.hypot(across, ((y + 0.5) / rows - place[1]) * pixels.shape[0] / width).ravel()
    ends = np.linspace(0.0, distance.max(), _FLASH_TERMS)
    rings = np.stack([np.interp(distance, ends, one) for one in np.eye(_FLASH_TERMS)], axis=1)
    # A highlight is white: it takes colour away where it is bright, however it is shaped.
    lit = np.concatenate([rings, _tiles(light).reshape(-1, 1)], axis=1)
    total = np.zeros_like(x)
    for measure, usual, terms in zip(measures, _USUAL, (rings, rings, lit, lit), strict=True):
        fitted = terms @ np.linalg.lstsq(terms, measure.ravel(), rcond=None)[0]
        total += ((measure - fitted.reshape(measure.shape)) / usual) ** 2
    return np.sqrt(total)


def _subject(photo: Photo, tiles: Values, falloff: float) -> Finding:
    """Whether there is a material to capture, by its unevenness; the first reason against it."""
    pixels, check = photo.pixels, CHECKS["subject"]
    light = _log(channel_mean(pixels))
    fine = float((blurred(light, 1.0) - blurred(light, 8.0)).std())
    # Smooth paint has equal neighbours, but no equal pixels a 32nd of the width apart.
    far = max(1, max(pixels.shape[:2]) // _SEPARATION)
    far_on, before, whole = slice(far, None), slice(-far), slice(None)
    pairs = [((far_on, whole), (before, whole)), ((whole, far_on), (whole, before))]
    same = [_every(pixels[one] == pixels[other]) for one, other in pairs]
    equal = min(float(each.mean()) for each in same)
    # Black gloss lit by a flash is in few codes: no drawing.
    dark = _every(pixels < _TENTH) & (falloff > CHECKS["flash"].limits[0])
    black = equal - min(
        float((each & ~dark[one]).mean()) for each, (one, _) in zip(same, pairs, strict=True)
    )
    mixed = float(np.sqrt(np.mean(np.square(tiles))))
    height, width = pixels.shape[:2]
    original, square = "give the photograph as the camera wrote it", "square above a flat sample"
    if fine < _BLANK:
        what, why = "the picture is one plain colour, without any texture", "nothing to measure"
        do = "photograph a material with its texture in focus, lit by the flash"
    elif equal - black > _EQUAL:
        what = (
            "the picture looks like a screenshot or a drawing, or is far overexposed: "
            f"{100.0 * equal:.0f} % of its pixels are exactly as others a 32nd of the width away"
        )
        why, do = "no photograph of a material has as many", original
    elif equal > _EQUAL and dark.mean() > _BLACK:
        what = f"{100 * dark.mean():.0f} % of the picture is black, in ten of 255 levels"
        why, do = "too short an exposure", f"photograph brighter or from nearer, {square}"
    elif (
        falloff < CHECKS["flash"].limits[2]
        and not photo.flash_fired
        and photo.clipped_share < CHECKS["clipped"].limits[2]  # white hides the flash
    ):
        what = "there is no flash in the picture: its middle is no brighter than its border"
        why, do = "the flash was off", f"photograph with the flash on, in a dark room, {square}"
    elif mixed > _MIXED:
        what = "no flat, even material fills the picture: its parts differ like several things"
        why = "an object, a face, or several materials"
        do = f"photograph {square}, so that nothing else is in the picture, or give --crop"
    elif max(width, height) < _SMALL:
        what, why = f"{width} x {height} pixels are few for a material", "a thumbnail"
        return check.rated(True, Rating.NOT_JUDGED, what=what, why=why, do=original)
    else:
        return check.rated(True, Rating.GOOD)
    return check.rated(False, Rating.FAILED, _NOT_ONE, what=what, why=why, do=do)


def _flash(photo: Photo, falloff: float) -> Finding:
    # Metadata may be wrong, and matte materials far from the flash have little falloff: use both.
    fired = photo.flash_fired
    severity = CHECKS["flash"].severity(falloff) + {None: 0.0, True: -0.5, False: 2.5}[fired]
    says = {
        None: "",
        True: ", and the file says that the flash fired",
        False: ", and the file says that the flash did not fire",
    }[fired]
    return CHECKS["flash"].finding(falloff, max(severity, 0.0), fired=says)


def _border(photo: Photo) -> tuple[Finding, ...]:
    """Proposal of a crop, if the border is not the material."""
    crop = None if photo.left_out is not None else border_crop(photo)
    if crop is None:
        return ()
    says = "The border differs from the rest, as where a sample ends."
    remedy = f"If it does, capture it with --crop {crop}."
    return (Finding("crop", str(crop), Rating.NOT_JUDGED, says, remedy),)


def _hot_spot(photo: Photo, place: tuple[float, float]) -> Finding:
    x, y = _upright(photo, *place)
    across, down = 100.0 * x, 100.0 * y
    says = f"{whereabouts(x, y)}, at {across:.0f} % from the left and {down:.0f} % from above"
    finding = CHECKS["hot_spot"].finding(min(x, 1.0 - x, y, 1.0 - y), where=says)
    return replace(finding, value=[round(x, 4), round(y, 4)])


def _tilt(photo: Photo, tilt: tuple[float, float] | None) -> Finding:
    if tilt is None:
        return CHECKS["tilt"].finding(math.nan)
    # The slope of the plane towards the camera, along x (right) and y (up) of photo.pixels.
    right, up = -math.degrees(tilt[1]), math.degrees(tilt[0])
    if photo.turned:
        right, up = up, -right
    degrees, side = math.hypot(right, up), _side(right, up)
    finding = CHECKS["tilt"].finding(
        degrees, side=f": the sample's {side} side was nearer", raised=side
    )
    value = {"degrees": round(degrees, 2), "right": round(right, 2), "up": round(up, 2)}
    return replace(finding, value=value)


def _sharpness(photo: Photo) -> Finding:
    height, width = photo.pixels.shape[:2]
    across = min(width, _SHARP)
    blur = softness(area_averaged(photo.pixels, (across, round(height * across / width))))
    return CHECKS["sharpness"].finding(blur, details=2.0 * blur, width=across)


def _stationarity(photo: Photo, tiles: Values) -> Finding:
    left, top, width, height = tile = largest_tile(tiles)
    where = whereabouts(*_upright(photo, left + 0.5 * width, top + 0.5 * height))
    finding = CHECKS["stationarity"].finding(float(np.sqrt(np.mean(tiles**2))), where=where)
    return replace(finding, where=upright_region(photo, tile))


def largest_tile(values: NDArray[Any]) -> Region:
    """The largest of tiles, in shares of the picture."""
    rows, columns = values.shape
    row, column = divmod(int(values.argmax()), columns)
    return column / columns, row / rows, 1.0 / columns, 1.0 / rows


def _radiometric(photo: Photo) -> Finding:
    if photo.radiometric:
        says = "A RAW: its numbers are proportional to light."
        return Finding("radiometric", True, Rating.GOOD, says)
    if photo.floating:
        says = "Floating-point numbers, taken as proportional to light."
        return Finding("radiometric", False, Rating.GOOD, says)
    says = "A developed picture: albedo is relative."
    remedy = "Photograph RAW (DNG) where the phone can."
    return Finding("radiometric", False, Rating.NOT_JUDGED, says, remedy)


def _reading(photo: Photo) -> tuple[Finding, ...]:
    """Notes of reading the file, as a finding."""
    notes = list(photo.remarks)
    if not notes:
        return ()
    unread = photo.headroom <= 1.0 and any(GAIN_MAP in note for note in notes)
    remedy = "Give the file as the camera wrote it, or switch HDR off." if unread else ""
    return (Finding("reading", notes, Rating.NOT_JUDGED, " ".join(notes), remedy),)


def _upright(photo: Photo, x: float, y: float) -> tuple[float, float]:
    """A position in photo.pixels as a position in the upright picture, both in shares.

    Portrait photographs are stored rotated by 90 degrees counterclockwise.
    """
    return (1.0 - y, x) if photo.turned else (x, y)


def upright_region(photo: Photo, region: Region) -> Region:
    """A region of photo.pixels in the upright picture."""
    left, top, width, height = region
    return (1.0 - top - height, left, height, width) if photo.turned else region


def whereabouts(x: float, y: float) -> str:
    """A position in shares from the upper left, as text."""
    across = "left" if x < 1 / 3 else "right" if x > 2 / 3 else ""
    down = "upper" if y < 1 / 3 else "lower" if y > 2 / 3 else ""
    if not across and not down:
        return "in the middle"
    if across and down:
        return f"at the {down} {across}"
    return f"on the {across}" if across else f"at the {'top' if down == 'upper' else 'bottom'}"


def _side(right: float, up: float) -> str:
    """The side of the picture towards which the plane approaches the camera, as text."""
    across = "right" if right > 0 else "left"
    down = "upper" if up > 0 else "lower"
    if abs(right) > 2.0 * abs(up):
        return across
    return down if abs(up) > 2.0 * abs(right) else f"{down} {across}"


def channel_mean(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W) mean of a picture's three channels: mean(axis=2) in a tenth of its time."""
    return (picture[..., 0] + picture[..., 1] + picture[..., 2]) / np.float32(3.0)


def _every(channels: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(H, W) whether all three channels are: all(axis=2) in a tenth of its time."""
    return channels[..., 0] & channels[..., 1] & channels[..., 2]


def _log(radiance: NDArray[Any]) -> NDArray[Any]:
    """Logarithm of radiance plus a share of its median."""
    log = np.asarray(radiance + _TOE * float(np.median(radiance)))
    log += 1e-9
    return np.log(log, out=log)


def _gradient_energy(light: NDArray[np.float32], scale: float) -> NDArray[np.float32]:
    smooth = cv2.GaussianBlur(light, (0, 0), scale)
    across, down = np.diff(smooth, axis=1)[:-1], np.diff(smooth, axis=0)[:, :-1]
    return across * across + down * down


def blurred(picture: NDArray[np.floating], deviation: float) -> NDArray[np.float32]:
    """A picture (H, W) or (H, W, C) blurred by a Gaussian; a wide one on a coarser grid."""
    step = int(deviation / _CELLS)
    if step < 2:
        return np.asarray(cv2.GaussianBlur(picture, (0, 0), deviation), np.float32)
    height, width = picture.shape[:2]
    size = (max(1, width // step), max(1, height // step))
    # Averaging and interpolation blur as well: variances s^2 / 12 and s^2 / 6 for a step of s.
    rest = math.sqrt(deviation**2 - step**2 / 4.0)
    across, down = rest * size[0] / width, rest * size[1] / height
    thin = cv2.GaussianBlur(area_averaged(picture, size), (0, 0), sigmaX=across, sigmaY=down)
    return np.asarray(cv2.resize(thin, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)


def band_passed(picture: NDArray[np.float32], fine: float, coarse: float) -> NDArray[np.float32]:
    """Difference of two Gaussian blurs of a picture, with these standard deviations in pixels."""
    band = blurred(picture, fine)
    band -= blurred(picture, coarse)
    return band


def _tiles(picture: NDArray[np.float32]) -> Values:
    """Averages over about square tiles, _TILES along the long side."""
    return cell_means(picture, _TILES).astype(np.float64)
