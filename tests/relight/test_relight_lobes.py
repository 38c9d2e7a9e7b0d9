"""The reflectance of the loops, and of plain NumPy in float64, is matcap.brdf's."""

import math

import numpy as np
import pytest
import torch
from loop_calls import lobe
from plain.lobes import ggx_smith, schlick_weight

from matcap.brdf import cook_torrance as reference
from matcap.relight.texture import alpha_of
from matcap.relight.vectors import dot


def directions(count, seed):
    """(3, count) unit vectors of the upper hemisphere, float64."""
    generator = np.random.default_rng(seed)
    vectors = generator.normal(size=(3, count))
    vectors[2] = np.abs(vectors[2])
    return vectors / np.linalg.norm(vectors, axis=0)


def specular(normal, to_view, to_light, roughness, f0):
    alpha = alpha_of(np.asarray(roughness))
    if alpha.dtype == np.float32:
        value, weight = lobe(normal, to_view, to_light, alpha)
    else:
        n_dot_v, n_dot_l = dot(normal, to_view), dot(normal, to_light)
        value, cosine = ggx_smith(normal, to_view, to_light, n_dot_v, n_dot_l, alpha)
        weight = schlick_weight(cosine)
    return value * (f0 + (1.0 - f0) * weight)


@pytest.mark.parametrize(("dtype", "limit"), [(np.float64, 1e-12), (np.float32, 2e-4)])
@pytest.mark.parametrize("roughness", [0.0, 0.02, 0.1, 0.5, 1.0])
def test_same_as_the_reference(dtype, limit, roughness):
    to_view, to_light = directions(500, 1), directions(500, 2)
    to_light[:, :250] = to_view[:, :250] * [[-1], [-1], [1]]  # mirrored: the peak
    normal = np.broadcast_to(np.array([[0.0], [0.0], [1.0]]), to_view.shape)
    rough = np.full(500, roughness)
    found = specular(
        tuple(normal.astype(dtype)),
        tuple(to_view.astype(dtype)),
        tuple(to_light.astype(dtype)),
        rough.astype(dtype),
        dtype(0.04),
    )
    assert found.dtype == dtype

    def image(array):
        return torch.from_numpy(np.ascontiguousarray(array)).reshape(-1, 1, 500)

    expected = reference.specular_lobe(
        torch.full((1, 1, 500), 0.04, dtype=torch.float64),
        image(rough[None]),
        reference.Angles.exact(
            image(normal),
            image(to_light.astype(dtype).astype(np.float64)),
            image(to_view.astype(dtype).astype(np.float64)),
        ),
    ).reshape(-1)
    # In float32 the very peak of a mirror cannot be told from its side.
    keep = slice(250, None) if dtype is np.float32 and roughness < 0.1 else slice(None)
    np.testing.assert_allclose(found[keep], expected.numpy()[keep], rtol=limit)


def test_worked_value():
    """Straight down on roughness 0.5 and F0 0.04: D = 1 / (pi alpha^2), V = 1/4."""
    up = (np.zeros(1), np.zeros(1), np.ones(1))
    expected = 1.0 / (math.pi * 0.25**2) / 4.0 * 0.04
    assert specular(up, up, up, np.full(1, 0.5), 0.04)[0] == pytest.approx(expected, rel=1e-12)
