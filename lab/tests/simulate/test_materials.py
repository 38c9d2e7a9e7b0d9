import numpy as np
import pytest
import torch
from random_maps import steepness

from matcap.errors import UsageError
from matcap_lab.simulate.named import MATERIALS, random_material, realise

WIDTH, HEIGHT, TEXEL = 256, 192, 2.0 / 512.0


def _check(maps):
    assert maps.size == (WIDTH, HEIGHT)
    assert maps.texel_size == TEXEL
    stacked = maps.stacked()
    assert stacked.dtype == torch.float64
    assert torch.isfinite(stacked).all()
    assert maps.diffuse.min() > 0.0 and maps.diffuse.max() < 1.0
    assert maps.specular.min() >= 0.02 and maps.specular.max() < 1.0
    assert maps.roughness.min() >= 0.05 and maps.roughness.max() <= 1.0


@pytest.mark.parametrize("name", MATERIALS)
def test_values_are_those_of_real_surfaces(name):
    maps = realise(name, WIDTH, HEIGHT, 1, TEXEL)
    _check(maps)
    assert 0.02 < steepness(maps) < 0.45
    metal = maps.specular > 0.45
    assert metal.any() == (name == "rust")
    # A metal's diffuse albedo is low, a dielectric's F0 is.
    assert (maps.diffuse.amax(0, keepdim=True)[metal] < 0.1).all()


@pytest.mark.parametrize("name", MATERIALS)
def test_a_seed_is_a_realisation(name):
    first, again, other = (realise(name, 96, 64, seed, TEXEL).stacked() for seed in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


@pytest.mark.parametrize("name", MATERIALS)
def test_seeds_agree_in_their_statistics(name):
    """The floor of every style error rests on this."""
    first, second = (realise(name, 512, 384, seed, TEXEL) for seed in (1, 2))
    for kind in ("diffuse", "specular", "roughness"):
        one, two = getattr(first, kind), getattr(second, kind)
        spread = float(one.std()) + 1e-3
        assert (one.mean((1, 2)) - two.mean((1, 2))).abs().max() < 0.3 * spread
        assert float(two.std()) == pytest.approx(float(one.std()), rel=0.25, abs=1e-3)
    assert steepness(second) == pytest.approx(steepness(first), rel=0.1)


@pytest.mark.parametrize("name", MATERIALS)
def test_quarters_agree_in_their_statistics(name):
    """Stationary: no corner of a photograph is another material."""
    diffuse = realise(name, 512, 384, 5, TEXEL).diffuse
    halves = [*diffuse.chunk(2, dim=1), *diffuse.chunk(2, dim=2)]
    means = torch.stack([half.mean((1, 2)) for half in halves])
    assert (means - diffuse.mean((1, 2))).abs().max() < 0.2 * float(diffuse.std()) + 0.002


def test_cloth_repeats_where_its_threads_do():
    """Period 26 texels at 1024 across: 13 a thread, two threads a period of plain weave."""
    texel = 2.0 / 1024.0
    warp = realise("cloth", 520, 390, 1, texel).diffuse[2].numpy()
    line = warp - warp.mean()
    correlation = [float((line[:, lag:] * line[:, : 520 - lag]).mean()) for lag in range(10, 40)]
    assert 10 + int(np.argmax(correlation)) == pytest.approx(26, abs=1)


def test_unknown_material_is_a_usage_error():
    with pytest.raises(UsageError, match="velvet.*choose from leather"):
        realise("velvet", 8, 8, 0, TEXEL)


def test_random_materials_are_sound_varied_and_reproducible():
    generator = np.random.default_rng(7)
    materials = [random_material(generator) for _ in range(30)]
    assert materials[0] == random_material(np.random.default_rng(7))
    assert len({material.base.pattern for material in materials}) >= 6
    slopes, roughness = [], []
    for index, material in enumerate(materials):
        maps = material.realise(WIDTH, HEIGHT, index, TEXEL)
        _check(maps)
        slopes.append(steepness(maps))
        roughness.append(float(maps.roughness.mean()))
    assert min(slopes) > 0.005 and max(slopes) < 1.0
    assert np.ptp(slopes) > 0.2 and np.ptp(roughness) > 0.4
    first, again, other = (materials[0].realise(96, 64, seed, TEXEL).height for seed in (1, 1, 2))
    assert torch.equal(first, again) and not torch.equal(first, other)
