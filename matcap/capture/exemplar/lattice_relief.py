"""Relief averaged over the cells of a lattice, each of which the flash lights from elsewhere.

At one place a photograph shows slopes along the direction of the flash only, and predicted relief
errs accordingly. The cells of a regular weave are the same surface under many directions, so that
their mean errs less than each of them:

1. the lattice's two waves are followed (example/fine_lattice.py) in log radiance and in predicted
   height at once, as the contrast of relief alone changes its sign across the mirror point;
2. threads that are out of step within two periods are aligned by optical flow [farneback2003] from
   the lattice, demodulated over some periods, to the photograph;
3. of the predicted height, what the lattice has locally is replaced by what it has everywhere; the
   rest is kept, and every octave keeps its slope energy.

Nothing changes without such a lattice, or where less than half of the relief is the same in all
cells: an irregular cloth would lose its own threads.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.capture.exemplar.octaves import split
from matcap.capture.exemplar.relief_spectrum import slope_energies
from matcap.example.fine_lattice import followed, read_grid, resized, shortest_waves
from matcap.example.lattice import GRID, Frequency
from matcap.photo.inspect import blurred

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]

# NSD is the normalised style distance (docs/notes/capture.md).
_LEAST_SHARE = 0.5  # of slope energy that is the same in all cells; 0.65 to 0.89 on four weaves
# Periods, standard deviations of the windows of the local lattice, of light and shading that are
# subtracted, and of the flow, which else follows noise within a thread.
_AROUND, _SLOW, _FLOW = 4.0, 3.0, 0.3
_HALVED = 8.0  # texels, shortest period that is followed in halved planes
_ORDER, _FINEST = 4, 0.45  # largest order and frequency of a cell's harmonics
_COARSE = 8  # texels between their local amplitudes
_QUANTILES = (0.01, 0.99)  # of log radiance: the range of the 8 bits that the flow takes
_LEAST_WINDOW = 9  # texels, of the flow
_SCALINGS = 3  # iterations of scaling octaves to their energies, as neighbours overlap
_MOST_FACTOR = 4.0


def averaged_over_cells(height: Floats, log: Floats, waves: Sequence[Frequency]) -> Floats:
    """Predicted height with its mean cell everywhere; unchanged without a lattice.

    Args:
        height: (H, W) predicted, texels.
        log: (H, W) log radiance less that of the coarse fit.
        waves: frequency vectors of the photograph's lattice, cycles per texel.
    """
    if len(waves) != 2:
        return height
    short = shortest_waves(*waves)
    period = 1.0 / max(math.hypot(*wave) for wave in short)
    texture = log - blurred(log, _SLOW * period)
    phases = _followed_phases(np.stack([texture, height]), short)
    if phases is None:
        return height
    local, _ = _on_lattice(texture, phases, short)
    phases = _aligned(phases, short, local, texture)
    local, cell = _on_lattice(height, phases, short)
    energy = slope_energies(height)
    if slope_energies(cell).sum() < _LEAST_SHARE * energy.sum():
        return height
    return _with_energies(cell + height - local, energy)


def _followed_phases(planes: Floats, waves: Sequence[Frequency]) -> Doubles | None:
    """(2, H, W) phases of two waves, turns, up to a constant; None if either gets lost.

    Long waves are followed in halved planes, in a quarter of the time.

    Args:
        planes: (C, H, W), each weighs the same.
        waves: approximate.
    """
    height, width = planes.shape[1:]
    step = 2 if max(math.hypot(*wave) for wave in waves) * _HALVED < 1.0 else 1
    thin = np.stack([resized(p, (width // step, height // step), cv2.INTER_AREA) for p in planes])
    thin -= thin.mean(axis=(1, 2), keepdims=True)
    thin /= thin.std(axis=(1, 2), keepdims=True) + np.float32(1e-9)
    y, x = np.mgrid[:height, :width].astype(np.float32) / np.float32(step)
    phases = []
    for across, down in waves:
        path = followed(thin, (step * across, step * down))
        if path is None:
            return None
        mean, turns = path
        bend = read_grid(turns, x / np.float32(1 << GRID), y / np.float32(1 << GRID))
        phases.append(mean[0] * x.astype(np.float64) + mean[1] * y + bend)
    return np.stack(phases)


def _aligned(
    phases: Doubles, waves: Sequence[Frequency], lattice: Floats, texture: Floats
) -> Doubles:
    """Phases (2, H, W) moved by the flow from a lattice (H, W) to a texture (H, W)."""
    period = 1.0 / max(math.hypot(*wave) for wave in waves)
    low, high = np.quantile(texture, _QUANTILES)
    codes = [
        ((plane - low) * (255.0 / max(high - low, 1e-6))).clip(0.0, 255.0).astype(np.uint8)
        for plane in (lattice, texture)
    ]
    window = max(_LEAST_WINDOW, round(0.8 * period))
    still = np.zeros((*texture.shape, 2), np.float32)
    shifts = cv2.calcOpticalFlowFarneback(codes[0], codes[1], still, 0.5, 2, window, 3, 5, 1.2, 0)
    flow = np.asarray(shifts, np.float32)
    right, down = (blurred(flow[..., axis], _FLOW * period) for axis in (0, 1))
    y, x = np.mgrid[: texture.shape[0], : texture.shape[1]].astype(np.float32)
    from_x, from_y = x - right, y - down
    moved = []
    for phase, wave in zip(phases, waves, strict=True):
        # Offsets from the straight wave are smooth; phases themselves are too large for float32.
        straight = wave[0] * x.astype(np.float64) + wave[1] * y
        offset = (phase - straight).astype(np.float32)
        there = cv2.remap(offset, from_x, from_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        moved.append(wave[0] * from_x.astype(np.float64) + wave[1] * from_y + there)
    return np.stack(moved)


def _on_lattice(
    plane: Floats, phases: Doubles, waves: Sequence[Frequency]
) -> tuple[Floats, Floats]:
    """(H, W) each: what the lattice has of a plane locally, and its mean cell everywhere."""
    height, width = plane.shape
    size = (max(1, width // _COARSE), max(1, height // _COARSE))
    deviation = _AROUND / max(math.hypot(*wave) for wave in waves) / _COARSE
    local, cell = np.zeros_like(plane), np.zeros_like(plane)
    first, second = ([_power(phase, n) for n in range(_ORDER + 1)] for phase in phases)
    for one, other in _harmonics(waves):
        wave = first[one] * (second[other] if other >= 0 else second[-other].conj())
        for part in (np.ascontiguousarray(wave.real), np.ascontiguousarray(wave.imag)):
            product = plane * part
            near = blurred(resized(product, size, cv2.INTER_AREA), deviation)
            local += 2.0 * part * resized(near, (width, height), cv2.INTER_LINEAR)
            cell += np.float32(2.0 * product.mean()) * part
    return local, cell


def _power(phase: Doubles, order: int) -> NDArray[np.complex64]:
    """(H, W) wave of an order at phases (H, W), turns."""
    angle = (2.0 * np.pi * (order * phase % 1.0)).astype(np.float32)
    return np.asarray(np.cos(angle) + 1j * np.sin(angle), np.complex64)


def _harmonics(waves: Sequence[Frequency]) -> Iterator[tuple[int, int]]:
    """Orders of the lattice's harmonics, one of each pair of opposite ones."""
    for orders in itertools.product(range(_ORDER + 1), range(-_ORDER, _ORDER + 1)):
        if orders > (0, 0) and math.hypot(*(np.array(orders) @ np.array(waves))) <= _FINEST:
            yield orders


def _with_energies(height: Floats, energy: Doubles) -> Floats:
    """Height (H, W) whose octaves have given slope energies."""
    *octaves, _ = split(height)
    bands = np.stack(octaves)
    factors = np.ones(len(bands))
    total = np.asarray(bands.sum(0), np.float32)
    for _ in range(_SCALINGS):
        ratio = np.sqrt(energy / slope_energies(total))
        factors = (factors * ratio).clip(1.0 / _MOST_FACTOR, _MOST_FACTOR)
        total = np.asarray(np.einsum("n,nhw->hw", factors, bands, optimize=False), np.float32)
    return total
