"""The stream of named materials, metals with a colour among them, as functions of their seeds."""

import numpy as np
import pytest
import torch
from random_maps import steepness

from matcap.flash.render import render_rectified
from matcap_lab.simulate.kinds import COLOURED_METALS, KINDS, kind_of, random_kind
from matcap_lab.simulate.kinds.metals_and_coats import (
    METAL_F0,
    anodised_f0,
    metal_colour,
)
from matcap_lab.simulate.specimen import subjects
from matcap_lab.simulate.varied import Draws

WIDTH, HEIGHT, TEXEL = 192, 144, 2.0 / 512.0
METALS = {"hammered", "brushed"}


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
        assert steepness(maps) > 0.6 * limits.slopes[0]
        assert steepness(maps) < 1.5 * (limits.slopes[1] + limits.grain[1])


@pytest.mark.parametrize("kind", [*KINDS, *COLOURED_METALS])
def test_a_seed_is_a_realisation_and_a_finer_grid_shows_the_same(kind):
    """Where everything lies does not depend on the texel size; edges may move by a texel."""
    material = kind_of(kind, 3)
    first, again, other = (material.realise(96, 64, seed, TEXEL).stacked() for seed in (1, 1, 2))
    assert torch.equal(first, again) and not torch.equal(first, other)
    plane, size = ("roughness", 2) if kind in COLOURED_METALS else ("diffuse", 1)
    width, height = size * WIDTH, size * HEIGHT
    coarse = getattr(material.realise(width // 2, height // 2, 1, TEXEL), plane)
    fine = getattr(material.realise(width, height, 1, TEXEL / 2), plane)
    shrunk = torch.nn.functional.avg_pool2d(fine, 2)
    together = torch.stack([coarse.log().flatten(), shrunk.log().flatten()])
    assert torch.corrcoef(together)[0, 1] > 0.75


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
    assert steepness(two) == pytest.approx(steepness(one), rel=0.3)


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


DRAWN = [
    ("scales", 3457461230), ("plates", 3470079269), ("herringbone", 2213306431),
    ("chipboard", 1227507580),
]  # fmt: skip
MEANS = {
    "hammered": [0.0524899541, 0.0378364141, 0.0236210175, 0.724425032, 0.654141456, -0.0133558543],
    "brushed": [0.039682617, 0.0255484736, 0.0138305815, 0.76265825, 0.305691335, 2.60697372e-06],
}
# Of these some texels are none.
PARTLY = {"rusted", "leafed"}


def chroma(colour):
    return float(np.ptp(colour) / colour.max())


@pytest.mark.parametrize("kind", COLOURED_METALS)
def test_values_are_those_of_metals(kind):
    limits = COLOURED_METALS[kind]
    for number in range(3):
        maps = kind_of(kind, number).realise(WIDTH, HEIGHT, 1, TEXEL)
        assert len(maps.specular) == 3 and torch.isfinite(maps.stacked()).all()
        assert maps.specular.max() <= 1.0 and maps.specular.min() >= 0.02
        metal = maps.specular.amax(0) > 0.3
        assert float(maps.diffuse[:, metal].mean()) < 0.02
        if kind in PARTLY:
            assert 0.05 < float(metal.double().mean()) < 0.98
            assert float(maps.specular[:, ~metal & (maps.specular.amax(0) < 0.1)].mean()) < 0.06
        assert steepness(maps) > 0.6 * limits.slopes[0]
        assert steepness(maps) < 1.5 * (limits.slopes[1] + limits.grain[1])


@pytest.mark.parametrize("name", METAL_F0)
def test_sheets_have_the_published_colour(name):
    maps = kind_of(name, 1).realise(WIDTH, HEIGHT, 3, TEXEL)
    found = maps.specular.mean((1, 2)).numpy()
    assert found == pytest.approx(METAL_F0[name], rel=0.06)
    assert found / found.sum() == pytest.approx(METAL_F0[name] / METAL_F0[name].sum(), rel=0.01)


def test_anodised_is_saturated_and_drawn_metals_are_of_many_colours():
    rng = Draws.of(0)
    dyed = [anodised_f0(rng) for _ in range(50)]
    assert min(chroma(one) for one in dyed) > 0.4
    assert max(one.max() for one in dyed) < 0.95
    drawn = [metal_colour(rng) for _ in range(400)]
    assert all(one.min() >= 0.04 and one.max() <= 1.0 for one in drawn)
    warm = np.mean([one[0] > 1.2 * one[2] for one in drawn])
    grey = np.mean([chroma(one) < 0.15 for one in drawn])
    assert 0.3 < warm < 0.75 and 0.15 < grey < 0.5


def test_the_stream_that_training_draws_from_is_what_it_was():
    """Names, and means of every plane, written before there was any colour."""
    assert not set(KINDS) & set(COLOURED_METALS)
    rng = np.random.default_rng(5)
    drawn = [random_kind(rng) for _ in range(4)]
    assert [(one.kind, one.number) for one in drawn] == DRAWN
    for kind, before in MEANS.items():
        maps = kind_of(kind, 7).realise(48, 32, 1, TEXEL)
        assert maps.stacked().mean((1, 2)).tolist() == pytest.approx(before, rel=1e-6, abs=1e-12)


def test_a_bench_accepts_them_by_name():
    found = subjects(["gold", "anodised:7"])
    assert [one.name for one in found] == ["gold", "anodised:7"]
    maps = found[0].pieces(11)(64, 48, 2.0 / 64)
    shot = render_rectified(maps, found[0].setup)
    bright = shot[:, shot.mean(0) > 0.5 * shot.mean(0).max()].mean(1).numpy()
    assert bright / bright.max() == pytest.approx(METAL_F0["gold"], rel=0.05)
