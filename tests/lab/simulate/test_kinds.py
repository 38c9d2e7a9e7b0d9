"""The stream of named materials: physical, stationary, and a function of its seed."""

import numpy as np
import pytest
import torch

from matcap.lab.simulate.materials.kinds import KINDS, kind_of, random_kind

WIDTH, HEIGHT, TEXEL = 192, 144, 2.0 / 512.0
METALS = {"hammered", "brushed"}


def _slope(maps):
    normal = maps.normal
    return float((normal[:2].square().sum(0) / normal[2].square()).mean().sqrt())


@pytest.mark.parametrize("kind", KINDS)
def test_values_are_those_of_real_surfaces(kind):
    limits = KINDS[kind]
    for number in range(2):
        maps = kind_of(kind, number).realise(WIDTH, HEIGHT, 1, TEXEL)
        assert maps.size == (WIDTH, HEIGHT)
        assert maps.stacked().dtype == torch.float64
        assert torch.isfinite(maps.stacked()).all()
        assert maps.diffuse.min() >= 0.01 and maps.diffuse.max() <= 0.9
        assert maps.roughness.min() >= 0.08 and maps.roughness.max() <= 0.95
        assert maps.specular.min() >= 0.025 and maps.specular.max() <= 0.95
        if kind in METALS:
            assert maps.specular.min() >= 0.4
            assert maps.diffuse.mean() < 0.15
        assert _slope(maps) > 0.6 * limits.slopes[0]
        assert _slope(maps) < 1.5 * (limits.slopes[1] + limits.grain[1])


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_is_a_realisation(kind):
    material = kind_of(kind, 4)
    first, again, other = (material.realise(48, 32, seed, TEXEL).stacked() for seed in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


@pytest.mark.parametrize("kind", KINDS)
def test_halves_and_seeds_agree_in_their_statistics(kind):
    """Stationary: no side of a photograph, and no other piece, is another material."""
    material = kind_of(kind, 2)
    one, two = (material.realise(2 * WIDTH, 2 * HEIGHT, seed, TEXEL) for seed in (5, 6))
    for name in ("diffuse", "roughness"):
        field = getattr(one, name)
        pieces = [*field.chunk(2, dim=1), *field.chunk(2, dim=2), getattr(two, name)]
        means = torch.stack([piece.mean((1, 2)) for piece in pieces])
        assert (means - field.mean((1, 2))).abs().max() < 0.45 * float(field.std()) + 0.004
    assert _slope(two) == pytest.approx(_slope(one), rel=0.3)


@pytest.mark.parametrize("kind", KINDS)
def test_a_finer_grid_shows_the_same_piece(kind):
    """Where everything lies does not depend on the texel size; edges may move by a texel."""
    material = kind_of(kind, 3)
    coarse = material.realise(WIDTH // 2, HEIGHT // 2, 1, TEXEL).diffuse
    fine = material.realise(WIDTH, HEIGHT, 1, TEXEL / 2).diffuse
    shrunk = torch.nn.functional.avg_pool2d(fine, 2)
    together = torch.stack([coarse.log().flatten(), shrunk.log().flatten()])
    assert torch.corrcoef(together)[0, 1] > 0.75


def test_the_stream_is_varied_and_reproducible():
    generator = np.random.default_rng(3)
    materials = [random_kind(generator) for _ in range(40)]
    assert materials[0] == random_kind(np.random.default_rng(3))
    assert len({material.kind for material in materials}) >= 16
    assert len({material.number for material in materials}) == 40


def test_grooves_are_darker_and_rougher_more_often_than_not():
    """Three of four, less those that are not tied at all, seen where grooves are plain to see."""
    darker, rougher = [], []
    for number in range(30):
        maps = kind_of("plates", number).realise(WIDTH, HEIGHT, 0, TEXEL)
        low = maps.height < maps.height.quantile(0.1)
        high = maps.height > maps.height.quantile(0.6)
        tone = maps.diffuse.mean(0, keepdim=True).log()
        darker.append(bool(tone[low].mean() < tone[high].mean()))
        rougher.append(bool(maps.roughness[low].mean() > maps.roughness[high].mean()))
    for share in (np.mean(darker), np.mean(rougher)):
        assert 0.55 < share < 0.95
