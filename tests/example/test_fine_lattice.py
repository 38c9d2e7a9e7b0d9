"""Exemplars with a fine lattice are straightened and get one cell, others are left alone."""

import numpy as np
import pytest

from matcap.capture.exemplar.estimate import indexed
from matcap.example.exemplar import Exemplar
from matcap.example.fine_lattice import straightened

WAVES = ((0.16, 0.02), (-0.03, 0.18))
WIDTH, HEIGHT = 512, 384


def woven(bend=0.0, contrast=0.0, noise=0.0):
    """An exemplar with a weave of some six texels, displaced by `bend` texels, at most twice.

    One of its waves is weaker by `contrast` in the middle, the other at the borders.
    """
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    at_x = x + bend * np.sin(2.2 * np.pi * y / HEIGHT) * np.cos(1.5 * np.pi * x / WIDTH)
    at_y = y + bend * np.cos(1.3 * np.pi * (x + y) / WIDTH)
    drawing = sum(
        (1.0 + changing * np.cos(2 * np.pi * x / WIDTH))
        * np.cos(2 * np.pi * (fx * at_x + fy * at_y))
        for changing, (fx, fy) in zip((contrast, -contrast), WAVES, strict=True)
    )
    rng = np.random.default_rng(1)
    drawing = drawing + noise * rng.standard_normal(drawing.shape)
    flat = np.ones((1, HEIGHT, WIDTH), np.float32)
    albedo = (0.3 * np.exp(0.2 * drawing)).clip(0.0, 1.0).astype(np.float32)
    stacked = np.concatenate(
        [albedo[None].repeat(3, 0), 0.04 * flat, 0.6 * flat, 0.001 * drawing[None]]
    )
    return Exemplar.certain(stacked.astype(np.float32), 2.0 / WIDTH).rounded()


def demodulated(exemplar, waves):
    """(waves, rows, columns) log albedo demodulated in squares of 32 texels."""
    log = np.log(exemplar.diffuse[1].astype(np.float64))
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    turned = [(log - log.mean()) * np.exp(-2j * np.pi * (fx * x + fy * y)) for fx, fy in waves]
    squares = np.reshape(turned, (len(waves), HEIGHT // 32, 32, WIDTH // 32, 32))
    return squares.mean(axis=(2, 4))[:, 1:-1, 1:-1]


def coherence(exemplar, waves):
    """Of each wave, |mean| over mean | |."""
    local = demodulated(exemplar, waves)
    return np.abs(local.mean(axis=(1, 2))) / np.abs(local).mean(axis=(1, 2))


def unevenness(exemplar, waves):
    """Of each wave, the largest over the least amplitude from left to right."""
    columns = np.abs(demodulated(exemplar, waves)).mean(axis=1)
    return columns.max(axis=1) / columns.min(axis=1)


@pytest.mark.parametrize("noise", [0.0, 0.5])
def test_a_bent_weave_becomes_straight_and_even(noise):
    bent = woven(bend=12.0, contrast=0.4, noise=noise)
    assert max(coherence(bent, WAVES)) < 0.6
    found = straightened(bent, WAVES)
    assert found is not None
    flat, waves = found
    assert min(coherence(flat, waves)) > 0.97
    assert min(unevenness(woven(contrast=0.4, noise=noise), WAVES)) > 1.8
    assert max(unevenness(flat, waves)) < 1.2
    # Texels that lie beyond the exemplar are not known.
    assert 0.9 < (flat.confidence > 0).mean() < 1.0


def test_the_shortest_waves_of_a_lattice_are_followed():
    (ax, ay), (bx, by) = WAVES
    flat, waves = straightened(woven(bend=12.0), ((ax, ay), (bx - 2 * ax, by - 2 * ay)))
    assert np.allclose(np.abs(waves), np.abs(WAVES), atol=0.01)


@pytest.mark.parametrize(
    ("exemplar", "waves"),
    [
        (woven(bend=0.5), WAVES),  # straight
        (woven(bend=12.0), WAVES[:1]),  # stripes
        (woven(bend=12.0, noise=20.0), WAVES),  # lost in noise
        (woven(bend=12.0), ((0.05, 0.0), (0.0, 0.05))),  # coarse: lattice.py follows its bend
        (woven(bend=12.0), ()),
    ],
)
def test_other_exemplars_are_left_alone(exemplar, waves):
    assert straightened(exemplar, waves) is None


def test_a_capture_keeps_the_maps_beside_the_photograph():
    bent = woven(bend=12.0)
    kept, example = indexed(bent, WAVES, turned=False)
    assert kept is bent
    assert min(coherence(example.exemplar, example.index.lattice.waves)) > 0.97
    assert not example.index.lattice.phase_offsets.std(axis=(1, 2)).any()
