"""Tilt from perspective: how the local spectra of a texture change across the picture.

The point p of the picture of a tilted plane shows the plane's point X = p (1 - t p), to first order
in the slopes t = (t_x, t_y), the tangents of its tilt over the camera's distance. A stationary
texture of spectrum S has at p the spectrum S(k + (t p) k + t (p k)) [malik1997], and

    log S_p - log S = grad log S . ((t p) k + t (p k)),

linear in t: least squares over the periodograms of overlapping windows, repeated on the picture
warped by the estimate. Free in each window is the energy of every octave, as the flash changes it.
Relief under a flash has more energy along the direction of the light, too: the second estimate
leaves local orientation free.
"""

from __future__ import annotations

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

ESTIMATES = 2
_WIDTHS = (256, 1024)  # columns of the picture that is read, at least and at most
_WINDOWS = 8  # windows across the picture, beside each other; they overlap by half
_LONGEST, _SHORTEST = 4.0, 0.35  # frequencies: cycles a window, cycles a pixel
# Rows or columns below which a window holds no such frequency; the slopes are unknown, then.
_LEAST_SIDE = 16
# Standard deviations of the spectra's blur in frequency bins, step by step, of each estimate.
_BLURS = ((2.5, 1.5, 0.8), (0.8, 0.8))
_MOST = 0.35  # of a slope: 28 degrees at a field of view of 66
_TOE = 0.03  # added inside the logarithm, as a share of the median radiance

Grey = NDArray[np.float32]


def convergence(pixels: Grey) -> Tensor:
    """(ESTIMATES, 4) slopes t_x and t_y, in 1 / plane units, and their standard deviations.

    Args:
        pixels: (H, W, 3), linear.
    """
    texture = _texture(pixels)
    if min(texture.shape) < _LEAST_SIDE:
        return torch.tensor(ESTIMATES * [[0.0, 0.0, _MOST, _MOST]])
    slope, estimates = np.zeros(2), []
    for oriented, blurs in enumerate(_BLURS):
        for blur in blurs:
            step, std = _gauss_newton_step(_warped(texture, slope), bool(oriented), blur)
            slope = (slope + step).clip(-_MOST, _MOST)
        estimates.append([*slope, *std])
    return torch.tensor(estimates, dtype=torch.float32)


def _texture(pixels: Grey) -> Grey:
    """Log luminance without its local mean, over its local deviation."""
    width = int(np.clip(pixels.shape[1], *_WIDTHS))
    size = (width, max(1, round(width * pixels.shape[0] / pixels.shape[1])))
    luminance = cv2.resize(pixels.mean(axis=-1), size, interpolation=cv2.INTER_AREA)
    log = np.log(luminance / max(float(np.median(luminance)), 1e-6) + _TOE).astype(np.float32)
    log -= cv2.GaussianBlur(log, (0, 0), width / 51)
    deviation = cv2.sqrt(cv2.GaussianBlur(log * log, (0, 0), width / 32))
    return np.asarray(np.clip(log / (deviation + 1e-3), -3.0, 3.0), np.float32)


def _warped(texture: Grey, slope: NDArray[np.float64]) -> Grey:
    """The texture as an untilted plane shows it, if it is tilted by `slope`."""
    height, width = texture.shape
    x, y = _places(np.arange(width), np.arange(height)[:, None], height, width)
    near = (1.0 - slope[0] * x - slope[1] * y) * (2.0 / width)
    columns, rows = x / near + (width - 1) / 2, (height - 1) / 2 - y / near
    maps = columns.astype(np.float32), rows.astype(np.float32)
    warped = cv2.remap(texture, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(warped, np.float32)


def _places(
    column: NDArray[np.int64], row: NDArray[np.int64], height: int, width: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Plane coordinates of the centres of pixels."""
    return (2 * column + 1 - width) / width, (height - 1 - 2 * row) / width


def _gauss_newton_step(
    texture: Grey, oriented: bool, blur: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least-squares change of the slopes, and its standard deviation.

    Args:
        texture: picture warped by the present slopes.
        oriented: leave the local orientation of each window free.
        blur: standard deviation of the spectra's blur, frequency bins.
    """
    power, centres = _window_spectra(texture, blur)
    side = power.shape[-1]
    k = np.fft.fftshift(np.fft.fftfreq(side))
    kx, ky = np.broadcast_arrays(k, -k[:, None])
    radius = np.hypot(kx, ky)
    half_plane = (kx > 0) | ((kx == 0) & (ky > 0))  # a real picture's spectrum is symmetric
    band = (radius >= _LONGEST / side) & (radius < _SHORTEST) & half_plane
    mean = np.log(power.mean(axis=0))
    down, right = np.gradient(mean)
    gx, gy, kx, ky = side * right[band], -side * down[band], kx[band], ky[band]
    # d log S / dt_x = x change[0] + y change[1], d log S / dt_y = x change[2] + y change[3]
    radial = gx * kx + gy * ky
    change = np.stack([radial + gx * kx, gx * ky, gy * kx, radial + gy * ky]).astype(np.float32)
    residual = np.log(power[:, band]) - mean[band]
    # What is free in each window is projected out of both sides of the equations.
    free = _free(kx, ky, side, oriented)
    change -= change @ free @ free.T
    residual = (residual - residual @ free @ free.T).clip(-2.0, 2.0)
    products = (change @ change.T).reshape(2, 2, 2, 2)
    normal = np.einsum("wa,taub,wb->wtu", centres, products, centres)  # by window w
    gradient = np.einsum("wa,wta->wt", centres, (residual @ change.T).reshape(-1, 2, 2))
    inverse = np.linalg.inv(normal.sum(axis=0) + 1e-3 * np.eye(2))
    step = inverse @ gradient.sum(axis=0)
    # Covariance from the scatter of windows, doubled as those that overlap by half count twice.
    scatter = gradient - normal @ step
    covariance = inverse @ (2.0 * scatter.T @ scatter) @ inverse + 1e-4 * inverse
    return step, np.sqrt(np.diagonal(covariance))


def _window_spectra(texture: Grey, blur: float) -> tuple[Grey, NDArray[np.float64]]:
    """(windows, side, side) periodograms, and the windows' centres (windows, 2), plane units."""
    height, width = texture.shape
    side = min(width // _WINDOWS, height) // 2 * 2
    corners = np.mgrid[0 : height - side + 1 : side // 2, 0 : width - side + 1 : side // 2]
    rows, columns = corners.reshape(2, -1)
    corner = zip(rows, columns, strict=True)
    power = _periodograms(np.stack([texture[y : y + side, x : x + side] for y, x in corner]), blur)
    middle = (side - 1) / 2
    return power, np.stack(_places(columns + middle, rows + middle, height, width), 1)


def _periodograms(windows: Grey, blur: float) -> Grey:
    """Of windows, blurred, with frequency 0 in the middle."""
    taper = np.hanning(windows.shape[-1]).astype(np.float32)
    windows = (windows - windows.mean(axis=(1, 2), keepdims=True)) * np.outer(taper, taper)
    spectrum = torch.fft.fftshift(torch.fft.fft2(torch.from_numpy(windows)), dim=(1, 2))
    power = torch.view_as_real(spectrum).square().sum(-1).numpy()
    power = np.stack([cv2.GaussianBlur(each, (0, 0), blur) for each in power])
    return np.asarray(power + (1e-4 * power.mean() + 1e-12), np.float32)


def _free(kx: NDArray[np.float64], ky: NDArray[np.float64], side: int, oriented: bool) -> Grey:
    """Orthonormal columns of what is free in each window: octaves, and local orientation."""
    octave = np.floor(np.log2(np.hypot(kx, ky) * side))
    columns = [octave == each for each in np.unique(octave)]
    if oriented:
        angle = 2.0 * np.arctan2(ky, kx)
        columns += [np.cos(angle), np.sin(angle)]
    return np.linalg.qr(np.stack(columns, axis=1).astype(np.float32))[0]
