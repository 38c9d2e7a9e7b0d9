"""Feature matches of two photographs [lowe2004], and comparison of registered ones."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from matcap.capture.registration.camera import (
    Doubles,
    PosedCamera,
    grid_points,
    to_pixels,
    transformed,
)
from matcap.capture.registration.one_place import FINE, normalise_contrast
from matcap.files.color import srgb_encode
from matcap.flash.light import CORNER_SQUARED
from matcap.photo.left_out import area_averaged
from matcap.photo.photo import Photo

# Feature matches of two photographs: SIFT keypoints [lowe2004] on normalised contrast.
#
# The flash moves with the camera, so shading differs between photographs: local contrast is
# normalised before detection, by its local mean amplitude, or by CLAHE where that gives few
# matches. Textures repeat, so mutual nearest neighbours are matched with a loose ratio test (0.95),
# and a homography selects the consistent ones.

ContrastNormalisation = Callable[[NDArray[np.float32]], NDArray[np.uint8]]
KeypointsBy = Callable[[ContrastNormalisation], "Keypoints"]  # of a photograph

# Settings of detection and matching.
LONG_SIDE = 1600  # pixels along the long side of the downsampled photograph
_MOST = 6000  # largest number of features of a photograph
_CONTRAST = 0.01  # contrast threshold of SIFT; low, as materials have little contrast
_RATIO = 0.95  # largest ratio of the distances of nearest and second nearest match [lowe2004]
_INLIER = 2.5  # largest distance of an inlier from the homography, pixels
_ENOUGH = 200  # inliers below which votes and the other contrast normalisation are tried as well
_VOTERS = 600  # largest number of matches that vote

# Test for periodic patterns.
_PERIOD_ACROSS = 640  # width of the downsampled photograph, pixels
_PERIOD_SLOW = 12.0  # larger standard deviation of the band-pass, pixels; the smaller is FINE
_NEAREST = 4  # least lag, pixels; at smaller ones any smooth texture correlates
_LARGEST_LAG = 0.2  # largest lag along each axis, as a share of the width
# Autocorrelation from which a pattern is periodic; leather, stone and plaster have below 0.07,
# most weaves 0.46 to 0.94 (docs/notes/several.md).
_PERIODIC = 0.35


@dataclass(frozen=True)
class Keypoints:
    """Keypoints of a photograph."""

    image: Doubles
    """(2, n) image coordinates."""
    described: NDArray[np.float32]
    """(n, 128) RootSIFT descriptors [arandjelovic2012]."""
    pixel: float
    """Size of a pixel in image coordinates."""
    shape: NDArray[np.complex128]
    """(n,) complex: the modulus is the size in image coordinates, the argument the orientation."""


def match_photographs(first: KeypointsBy, second: KeypointsBy) -> tuple[Doubles, Doubles, float]:
    """(2, n) image coordinates of inlier matches in both, and a pixel's size in the second."""
    candidates = []
    for normalise in (normalise_contrast, equalise_histogram):
        other = second(normalise)
        candidates.append((*matched(first(normalise), other), other.pixel))
        if candidates[-1][0].shape[1] >= _ENOUGH:
            break
    return max(candidates, key=lambda candidate: candidate[0].shape[1])


def find_keypoints(photo: Photo, normalise: ContrastNormalisation) -> Keypoints:
    """Keypoints of a photograph after a normalisation of its contrast."""
    rows, columns = photo.pixels.shape[:2]
    shrunk = min(1.0, LONG_SIDE / columns)
    size = (round(columns * shrunk), round(rows * shrunk))
    grey = area_averaged(photo.pixels, size).mean(2)
    # Without precise upscaling, all coordinates are biased by a quarter of a pixel.
    sift = cv2.SIFT.create(_MOST, contrastThreshold=_CONTRAST, enable_precise_upscale=True)
    points, described = sift.detectAndCompute(normalise(np.asarray(grey, np.float32)), None)
    if described is None:
        points, described = (), np.zeros((0, 128), np.float32)
    share = described / np.maximum(described.sum(1, keepdims=True), 1e-6)
    places = np.array([point.pt for point in points], np.float64).reshape(-1, 2).T
    half = size[0] / 2.0
    image = np.stack([places[0] + 0.5 - half, size[1] / 2.0 - places[1] - 0.5]) / half
    # OpenCV's angles are clockwise.
    shape = np.array([p.size / half * np.exp(-1j * np.radians(p.angle)) for p in points], complex)
    return Keypoints(image, np.sqrt(share, dtype=np.float32), 1.0 / half, shape)


def equalise_histogram(grey: NDArray[np.float32]) -> NDArray[np.uint8]:
    """8-bit sRGB code after contrast-limited adaptive equalisation (CLAHE [zuiderveld1994])."""
    # Normalise exposure by the median.
    level = 0.25 / max(float(np.median(grey)), 1e-6)
    codes = (255.0 * srgb_encode((grey * level).clip(0.0, 1.0))).round().astype(np.uint8)
    return np.asarray(cv2.createCLAHE(3.0, (12, 12)).apply(codes))


def matched(first: Keypoints, second: Keypoints) -> tuple[Doubles, Doubles]:
    """(2, n) image coordinates in both photographs of matches consistent with a homography.

    The homography is estimated by MAGSAC++ [barath2020].
    """
    nothing = np.zeros((2, 0))
    if min(len(first.described), len(second.described)) < 8:
        return nothing, nothing
    i, j = mutual_nearest(first.described, second.described, _RATIO)
    if len(i) < 8:
        return nothing, nothing
    one, other = first.image[:, i], second.image[:, j]
    # Thresholds are in pixels.
    places = one / first.pixel, other / second.pixel
    _, chosen = _homography(*places)
    if chosen.sum() < _ENOUGH:
        among = _consistent(_voted(one, other, second.shape[j] / first.shape[i]), *places)
        chosen = among if among.sum() > chosen.sum() else chosen
    return one[:, chosen], other[:, chosen]


def mutual_nearest(
    first: NDArray[np.float32], second: NDArray[np.float32], ratio: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices of mutual nearest neighbours of descriptors (n, 128) and (m, 128).

    Args:
        first, second: at least two rows each.
        ratio: upper limit of the ratio test, nearest over second nearest distance.
    """
    distances = torch.cdist(torch.from_numpy(first), torch.from_numpy(second))
    # NumPy's argmin along rows, and minima of columns, take a fifth of the time of torch's argmin.
    least, nearest = distances.amin(0), torch.from_numpy(distances.numpy().argmin(1))
    closest = distances.gather(1, nearest[:, None])[:, 0]
    distances.scatter_(1, nearest[:, None], torch.inf)
    clear = closest < ratio * distances.amin(1)
    kept = (clear & (closest == least[nearest])).nonzero()[:, 0]
    return kept.numpy(), nearest[kept].numpy()


def _homography(one: Doubles, other: Doubles) -> tuple[Doubles | None, NDArray[np.bool_]]:
    """Robust homography (3, 3) of matches (2, n), pixels, or None, and (n,) its inliers."""
    nothing = np.zeros(one.shape[1], bool)
    if one.shape[1] < 8:
        return None, nothing
    matrix, kept = cv2.findHomography(
        one.T, other.T, cv2.USAC_MAGSAC, _INLIER, maxIters=20000, confidence=0.9999
    )
    if matrix is None or kept is None:
        return None, nothing
    return np.asarray(matrix), kept.ravel() > 0


def _consistent(some: NDArray[np.bool_], one: Doubles, other: Doubles) -> NDArray[np.bool_]:
    """(n,) bool, inliers of the homography that is fitted to `some` of the matches."""
    matrix, _ = _homography(one[:, some], other[:, some])
    among = np.zeros(one.shape[1], bool)
    if matrix is None:
        return among
    near = np.hypot(*(transformed(matrix, one) - other)) < 4.0 * _INLIER
    _, among[near] = _homography(one[:, near], other[:, near])
    return among


def _voted(one: Doubles, other: Doubles, shapes: NDArray[np.complex128]) -> NDArray[np.bool_]:
    """(n,) bool, matches consistent with the similarity of the match that has most support.

    The scale and rotation of a match predict the others around it [lowe2004, section 7.1]. This
    works with one correct match in fifty, where sampling four for a homography fails.

    Args:
        one, other: (2, n) image coordinates.
        shapes: (n,) complex, scale and rotation of features in the second over the first.
    """
    first, second = one[0] + 1j * one[1], other[0] + 1j * other[1]
    step = -(-len(first) // _VOTERS)
    between = first[None] - first[::step, None]
    error = np.abs(second[::step, None] + shapes[::step, None] * between - second[None])
    far, ratio = np.abs(between), np.abs(np.log(shapes[None] / shapes[::step, None]))
    # Perspective makes the tolerance grow with distance; matches at the same point do not vote.
    along = (error < 0.03 + 0.3 * far) & (ratio < 0.6) & (far < 0.7)
    votes = (along & (far > 0.02)).sum(1)
    return np.asarray(along[int(np.argmax(votes))])


def is_periodic(photo: Photo) -> bool:
    """Whether the photographed pattern is periodic: a maximum of its autocorrelation > _PERIODIC.

    Matches are then ambiguous by whole periods: only aperiodic features (stains, flaws, a border)
    resolve the ambiguity, and with too few of them the matches are inconsistent.
    """
    rows, columns = photo.pixels.shape[:2]
    wide = min(columns, _PERIOD_ACROSS)
    size = (wide, round(wide * rows / columns))
    grey = area_averaged(photo.pixels.mean(2), size)
    log = np.log(np.maximum(grey, 1e-5)).astype(np.float32)
    texture = cv2.GaussianBlur(log, (0, 0), FINE) - cv2.GaussianBlur(log, (0, 0), _PERIOD_SLOW)
    texture -= texture.mean()
    fields = [texture, np.ones_like(texture)]
    whole = tuple(2 * side for side in texture.shape)
    products, overlap = (
        np.fft.irfft2(np.abs(np.fft.rfft2(each, whole)) ** 2, whole) for each in fields
    )
    most = round(_LARGEST_LAG * wide)
    lags = tuple(np.mgrid[:most, -most:most])
    correlation = (products[lags] / overlap[lags]).astype(np.float32)
    highest = correlation == cv2.dilate(correlation, np.ones((5, 5), np.uint8))
    maxima = correlation[highest & (np.hypot(*lags) >= _NEAREST)]
    return float(maxima.max(initial=-1.0)) > _PERIODIC * float(correlation[0, most])


# Comparison of registered photographs on the plane: correlation of texture, sharpness, shadows.
#
# Sharpness is the ratio of the amplitudes of the finest band and of a band of four times the
# wavelength: defocus and motion lower it, light hardly affects it.

ChannelPlane = NDArray[np.float32]

# Settings of the comparison; docs/notes/several.md.
_COMPARED = 384  # texels across the grid of the correlation
_SHIFTED = 5  # shift in texels at which the correlation must be lower
_ACROSS = 640  # texels across the grid of sharpness
_TILES = 12  # tiles across
_NEAR = 0.01  # plane units, distance over which the scale of a photograph is measured
_FINE = (0.7, 1.4)  # standard deviations of the two Gaussians of the finest band, texels
_LONG = (2.8, 5.6)  # standard deviations of the two Gaussians of the longer band, texels
_CELLS = 48  # cells across the grid of shadows
SHADOW = math.log(2.0)  # log radiance below what others show from which a place is in shadow
_MIRRORS = 0.25  # of the distance, around a camera's foot, where its highlight may be
_FALLOFF = (0.3, 0.5)  # of lens and flash, the coarse fit's prior mean, as of log_vignette


def texture_correlations(seen: Sequence[tuple[Photo, PosedCamera]]) -> list[float]:
    """Correlation of the fine texture of each photograph but the first with it, over their overlap.

    In [-1, 1]; -1 without overlap, or if a shift by a few texels correlates better.
    """
    rows, columns = seen[0][0].pixels.shape[:2]
    down = round(_COMPARED * rows / columns)
    (texture, inside), *others = (_texture(*each, down) for each in seen)

    def correlation(other: ChannelPlane, both: NDArray[np.bool_], x: int, y: int) -> float:
        a, b = texture[both], np.roll(other, (y, x), (0, 1))[both]
        return float((a * b).mean() / max(float(np.sqrt((a * a).mean() * (b * b).mean())), 1e-9))

    correlations, far = [], _SHIFTED
    for other, other_inside in others:
        both = inside & other_inside
        if both.mean() < 0.05:
            correlations.append(-1.0)
            continue
        shifts = ((far, 0), (-far, 0), (0, far), (0, -far))
        shifted = max(correlation(other, both, x, y) for x, y in shifts)
        aligned = correlation(other, both, 0, 0)
        correlations.append(aligned if aligned > shifted else -1.0)
    return correlations


def _texture(
    photo: Photo, camera: PosedCamera, down: int
) -> tuple[ChannelPlane, NDArray[np.bool_]]:
    """(down, _COMPARED) high-passed log radiance over its local contrast on the plane, its mask."""
    size = (_COMPARED, down)
    log, inside = log_on_grid(photo, camera, size, _COMPARED, 1e-5, cv2.INTER_LINEAR)
    fine = _band(log, 1.0, 6.0)
    contrast = np.sqrt(cv2.GaussianBlur(fine * fine, (0, 0), 12.0)) + 1e-4
    return (fine / contrast).astype(np.float32), inside


def losses_of_sharpness(photos: Sequence[Photo], cameras: Sequence[PosedCamera]) -> list[float]:
    """Log loss of sharpness of each photograph relative to the median one; positive is blurred.

    Compared where it and the first photograph overlap; 0 without overlap.
    """
    both = zip(photos, cameras, strict=True)
    first, *others = (_sharpness(photo, camera, photos[0]) for photo, camera in both)
    losses = []
    for each in (first, *others):
        seen = np.isfinite(each) & np.isfinite(first)
        losses.append(float(np.median((first - each)[seen])) if seen.sum() > 4 else 0.0)
    middle = sorted(losses)[(len(losses) - 1) // 2]  # of two, the sharper one
    return [loss - middle for loss in losses]


def _sharpness(photo: Photo, camera: PosedCamera, first: Photo) -> NDArray[np.float64]:
    """(tiles,) log sharpness on the first photograph's plane; NaN for a tile partly outside.

    A photograph from farther away or aside has fewer pixels a texel: it is shrunk less.
    """
    down = round(_ACROSS * first.pixels.shape[0] / first.pixels.shape[1])
    corners = camera.sees(np.array([[0.0, _NEAR, 0.0], [0.0, 0.0, _NEAR], [0.0, 0.0, 0.0]]))
    by_plane = (corners[:, 1:] - corners[:, :1]) / _NEAR
    smaller = abs(float(np.linalg.det(by_plane))) ** 0.5
    wide = min(photo.pixels.shape[1], round(_ACROSS / np.clip(smaller, 0.25, 1.0)))
    log, inside = log_on_grid(photo, camera, (_ACROSS, down), wide, 1e-4, cv2.INTER_CUBIC)
    bands = (np.square(_band(log, *deviations)) for deviations in (_FINE, _LONG))
    tiles = (_TILES, max(2, round(_TILES * down / _ACROSS)))
    planes = *bands, inside.astype(np.float32)
    fine, long, seen = (area_averaged(each, tiles).ravel() for each in planes)
    ratio = 0.5 * np.log((fine + 1e-9) / (long + 1e-9))
    return np.where(seen > 0.99, ratio, np.nan).astype(np.float64)


def shares_in_shadow(seen: Sequence[tuple[Photo, PosedCamera]]) -> list[float]:
    """Share of each flash photograph that is far darker than another shows the same place.

    Log radiance less that of a matte, even surface is compared with the median of the others',
    where these cannot mirror their flash.
    """
    rows, columns = seen[0][0].pixels.shape[:2]
    size = (_CELLS, round(_CELLS * rows / columns))
    points, logs, mirroring = grid_points(*size), [], []
    for photo, camera in seen:
        log, inside = log_on_grid(photo, camera, size, _CELLS, 1e-4, cv2.INTER_LINEAR)
        to_camera = camera.place[:, None, None] - points
        squared = np.square(camera.sees(points)).sum(0) / CORNER_SQUARED
        matte = np.log(to_camera[2]) - 1.5 * np.log(np.square(to_camera).sum(0))
        matte -= _FALLOFF[0] * squared + _FALLOFF[1] * np.square(squared)
        logs.append(np.where(inside, log - matte, np.nan))
        mirroring.append(np.hypot(*to_camera[:2]) < _MIRRORS * camera.place[2])
    shares = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # places that no other photograph shows
        for number, own in enumerate(logs):
            others = [k for k in range(len(logs)) if k != number]
            darker = own - np.nanmedian([logs[other] for other in others], axis=0)
            mirrored = np.all([mirroring[other] for other in others], axis=0)
            known = np.isfinite(darker) & ~mirrored
            dark = darker[known] < np.nanmedian(darker) - SHADOW
            shares.append(float(dark.mean()) if dark.size else 0.0)
    return shares


def _band(plane: ChannelPlane, fine: float, coarse: float) -> ChannelPlane:
    """Difference of two Gaussian blurs of these standard deviations, texels."""
    near, far = (cv2.GaussianBlur(plane, (0, 0), deviation) for deviation in (fine, coarse))
    return np.asarray(near - far, np.float32)


def log_on_grid(
    photo: Photo, camera: PosedCamera, size: tuple[int, int], wide: int, darkest: float, how: int
) -> tuple[ChannelPlane, NDArray[np.bool_]]:
    """(down, across) each: log radiance of a photograph on the plane's grid, and where it is seen.

    Args:
        photo: the photograph; the mean of its channels is looked up.
        size: (across, down) texels of the grid.
        wide: pixels across to which the photograph is averaged before.
        darkest: radiance below which the logarithm is clamped.
        how: OpenCV interpolation.
    """
    rows, columns = photo.pixels.shape[:2]
    small = (wide, round(wide * rows / columns))
    grey = area_averaged(photo.pixels, small).mean(2)
    log = np.log(np.maximum(grey, darkest)).astype(np.float32)
    x, y = to_pixels(camera.sees(grid_points(*size)), *small)
    inside = (x > 1) & (x < small[0] - 2) & (y > 1) & (y < small[1] - 2)
    resampled = cv2.remap(log, x, y, how, borderMode=cv2.BORDER_REFLECT_101)
    return np.asarray(resampled, np.float32), np.asarray(inside)
