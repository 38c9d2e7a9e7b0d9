"""Height from slopes, and at another resolution; imports no PyTorch."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

HeightPlane = NDArray[np.float32]

# Height from slopes by least squares [frankot1988]: periodic, or with free borders.
#
# A map set that tiles is integrated by Fourier transforms, the relief of a photographed rectangle,
# whose opposite borders do not fit, by cosine transforms.


def integrate_periodic(slopes: NDArray[np.floating], texel_size: float = 1.0) -> HeightPlane:
    """(1, H, W) periodic height of mean 0 whose slopes fit given ones by least squares.

    In the Fourier domain H = -i (w . S) / |w|^2. The slopes' means and curl, which no periodic
    surface has, do not contribute.

    Args:
        slopes: (2, H, W) dh/dx and dh/dy, y upwards, row 0 at the top.
        texel_size: a texel's side, in the unit of the height.
    """
    rows, columns = slopes.shape[1:]
    wx = 2.0 * np.pi * np.fft.fftfreq(columns)[None, :] / texel_size
    wy = -2.0 * np.pi * np.fft.fftfreq(rows)[:, None] / texel_size
    squared = wx * wx + wy * wy
    squared[0, 0] = 1.0
    spectrum = -1j * (wx * np.fft.fft2(slopes[0]) + wy * np.fft.fft2(slopes[1])) / squared
    spectrum[0, 0] = 0.0
    return np.fft.ifft2(spectrum).real[None].astype(np.float32)


def integrate(across: HeightPlane, down: HeightPlane) -> HeightPlane:
    """(H, W) height of zero mean by least squares: the inverse of differences of neighbours.

    The Poisson equation with Neumann boundaries, solved by the discrete cosine transform.

    Args:
        across: (H, W - 1) rise from each texel to the one right of it.
        down: (H - 1, W) rise to the one below.
    """
    height, width = across.shape[0], down.shape[1]
    divergence = np.zeros((height + height % 2, width + width % 2), np.float32)
    # cv2.dct requires even sides; an added row or column of zero rise hardly changes the result.
    added = [(0, height % 2), (0, width % 2)]
    across, down = np.pad(across, added), np.pad(down, added)
    divergence[:, :-1] += across
    divergence[:, 1:] -= across
    divergence[:-1] += down
    divergence[1:] -= down
    return np.ascontiguousarray(poisson(divergence)[:height, :width])


def poisson(divergence: HeightPlane, across: float = 1.0, down: float = 1.0) -> HeightPlane:
    """Solve across d2h/dx2 + down d2h/dy2 = divergence for h (H, W), texels, of zero mean.

    Second differences, Neumann boundaries.
    """
    rows, columns = (
        2.0 * np.cos(np.pi * np.arange(side) / side) - 2.0 for side in divergence.shape
    )
    laplacian = down * rows[:, None] + across * columns
    laplacian[0, 0] = 1.0
    waves = cv2.dct(divergence) / laplacian.astype(np.float32)
    waves[0, 0] = 0.0
    return np.asarray(cv2.idct(waves), np.float32)


# Heights whose central differences keep slopes.
#
# Central differences show sin(w) of a wave of frequency w per texel, the surface has w. Averaged
# heights so lose slopes, which these filters restore; enlarged ones gain.

# Weight of given heights against slopes, for waves of 2 texels, which central differences do not
# show. Smaller values ring more: by a tenth of a height step's largest slope.
_DAMPING = 0.2
_MORE_DAMPING = 4.0  # where heights are estimates; 1 makes highlights too wide (hammered metal)
_BEYOND = 16  # texels around a grid, over which corrections at its border fade
# Pole of the cubic B-spline's inverse, and its taps on either side: 0.268^12 is 1.4e-7.
_POLE, _SPLINE_REACH = np.sqrt(3.0) - 2.0, 12


def with_slopes_of_means(height: HeightPlane) -> HeightPlane:
    """(H, W) heights whose slopes are those of the surface of which given ones are area means.

    The mean slope over a texel is w times the mean height. By least squares, heights are multiplied
    by

        (w . sin(w) + e) / (|sin(w)|^2 + e),    e = (sin^2(w_x / 2) + sin^2(w_y / 2))^2.

    Borders are mirrored.
    """
    rows, columns = height.shape
    even = np.pad(height, [(0, rows % 2), (0, columns % 2)], mode="edge")  # cv2.dct requires it
    down, across = (np.pi * np.arange(side) / side for side in even.shape)
    damping = _damping(down[:, None], across, _MORE_DAMPING)
    wanted = (down * np.sin(down))[:, None] + across * np.sin(across) + damping
    shown = np.square(np.sin(down))[:, None] + np.square(np.sin(across)) + damping
    wanted[0, 0] = shown[0, 0] = 1.0
    gain = (wanted / shown).astype(np.float32)
    waves = cv2.dct(even.astype(np.float32)) * gain
    return np.ascontiguousarray(cv2.idct(waves)[:rows, :columns])


def resized_height(height: HeightPlane, size: tuple[int, int]) -> HeightPlane:
    """(h, w) heights of `size` = (w, h) whose slopes are those of given ones (H, W).

    Larger: cubic splines. Smaller: area means plus the correction c that minimises

        sum |S(c) - r|^2 + _DAMPING |F^-1((sin^2(w_x / 2) + sin^2(w_y / 2)) F(c))|^2,

    with S central differences and r what those of the area means lack of the mean slopes.
    """
    shape = size[1], size[0]
    if height.shape == shape:
        return height
    if min(*height.shape, *shape) < 2:  # a line has no central differences
        return _area_mean(height, shape)
    if shape[1] > height.shape[1]:
        return spline_enlarged(height, size)
    mean = _area_mean(height, shape)
    each = zip(np.gradient(height), height.shape, shape, np.gradient(mean), strict=True)
    lacking = [
        np.pad(_area_mean(slope * np.float32(side / new), shape) - shown, _BEYOND)
        for slope, side, new, shown in each
    ]
    beyond = lacking[0].shape
    down = 2.0 * np.pi * np.fft.fftfreq(beyond[0])[:, None]
    across = 2.0 * np.pi * np.fft.rfftfreq(beyond[1])
    power = np.square(np.sin(down)) + np.square(np.sin(across)) + _damping(down, across, _DAMPING)
    waves = [np.fft.rfft2(slope) for slope in lacking]
    solved = (np.sin(down) * waves[0] + np.sin(across) * waves[1]) / np.maximum(power, 1e-12)
    change = np.fft.irfft2(-1j * solved, s=beyond)[_BEYOND:-_BEYOND, _BEYOND:-_BEYOND]
    return np.asarray(mean + change, np.float32)


def _damping(
    down: NDArray[np.floating], across: NDArray[np.floating], weight: float
) -> NDArray[np.float64]:
    """Weight of the heights of waves; nothing at long ones, `weight` at 2 texels along an axis."""
    both = np.square(np.sin(0.5 * down)) + np.square(np.sin(0.5 * across))
    return np.asarray(weight * np.square(both), np.float64)


def _area_mean(plane: HeightPlane, shape: tuple[int, ...]) -> HeightPlane:
    """Means over areas, (H, W) = shape."""
    size = shape[1], shape[0]
    return np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_AREA), np.float32)


def spline_enlarged(plane: HeightPlane, size: tuple[int, int]) -> HeightPlane:
    """Interpolate a plane (H, W) to (width, height) by cubic B-splines [unser1999].

    Quadratics are reproduced inside, so that slopes of heights are kept; OpenCV's cubic kernel errs
    in them by 0.77 to 1.33, periodically. Borders are mirrored.
    """
    taps = np.arange(-_SPLINE_REACH, _SPLINE_REACH + 1)
    inverse = np.sqrt(3.0) * _POLE ** np.abs(taps)
    filtered = cv2.sepFilter2D(plane, cv2.CV_32F, inverse, inverse, borderType=cv2.BORDER_REFLECT)
    down = _spline_rows(np.asarray(filtered, np.float32), size[1])
    return np.ascontiguousarray(_spline_rows(np.ascontiguousarray(down.T), size[0]).T)


def _spline_rows(nodes: HeightPlane, count: int) -> HeightPlane:
    """Values of cubic B-splines with coefficients `nodes` (N, W) at `count` rows."""
    at = (np.arange(count) + 0.5) * (len(nodes) / count) - 0.5
    first = np.floor(at).astype(np.int64)
    t = (at - first).astype(np.float32)
    weights = (
        (1.0 - t) ** 3 / 6.0,
        2.0 / 3.0 - t * t * (1.0 - t / 2.0),
        2.0 / 3.0 - (1.0 - t) ** 2 * (1.0 + t) / 2.0,
        t**3 / 6.0,
    )
    values = np.zeros((count, nodes.shape[1]), np.float32)
    for step, weight in enumerate(weights, -1):
        index = first + step
        index = np.where(index < 0, -1 - index, index)
        index = np.where(index >= len(nodes), 2 * len(nodes) - 1 - index, index)
        values += weight[:, None] * nodes[index.clip(0, len(nodes) - 1)]
    return values
