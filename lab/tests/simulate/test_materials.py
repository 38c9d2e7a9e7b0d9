"""Simulated materials: what a seed, a size and a kind mean, and values of real surfaces."""

import math

import numpy as np
import pytest
import torch
from random_maps import steepness

from matcap.errors import UsageError
from matcap.flash.light import render_rectified
from matcap_lab.simulate.kinds import COLOURED_METALS, KINDS, kind_of, random_kind
from matcap_lab.simulate.kinds.metals_and_coats import METAL_F0, anodised_f0, metal_colour
from matcap_lab.simulate.named import MATERIALS, random_material, realise
from matcap_lab.simulate.procedural import Canvas, Spectrum, bumps, cells, noise, weave
from matcap_lab.simulate.specimen import subjects
from matcap_lab.simulate.varied import Draws

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
    warp = realise("cloth", 520, 390, 1, 2.0 / 1024.0).diffuse[2].numpy()
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


# The stream of named materials, metals with a colour among them, as functions of their seeds.

ACROSS, DOWN, KIND_TEXEL = 192, 144, 2.0 / 512.0
METALS = {"hammered", "brushed"}


@pytest.mark.parametrize("kind", KINDS)
def test_values_of_kinds_are_those_of_real_surfaces(kind):
    limits = KINDS[kind]
    for number in range(2):
        maps = kind_of(kind, number).realise(ACROSS, DOWN, 1, KIND_TEXEL)
        assert maps.size == (ACROSS, DOWN)
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
    first, again, other = (
        material.realise(96, 64, seed, KIND_TEXEL).stacked() for seed in (1, 1, 2)
    )
    assert torch.equal(first, again) and not torch.equal(first, other)
    plane, size = ("roughness", 2) if kind in COLOURED_METALS else ("diffuse", 1)
    width, height = size * ACROSS, size * DOWN
    coarse = getattr(material.realise(width // 2, height // 2, 1, KIND_TEXEL), plane)
    fine = getattr(material.realise(width, height, 1, KIND_TEXEL / 2), plane)
    shrunk = torch.nn.functional.avg_pool2d(fine, 2)
    together = torch.stack([coarse.log().flatten(), shrunk.log().flatten()])
    assert torch.corrcoef(together)[0, 1] > 0.75


@pytest.mark.parametrize("kind", KINDS)
def test_halves_and_seeds_agree_in_their_statistics(kind):
    """Stationary: no side of a photograph, and no other piece, is another material."""
    material = kind_of(kind, 2)
    one, two = (material.realise(2 * ACROSS, 2 * DOWN, seed, KIND_TEXEL) for seed in (5, 6))
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
        maps = kind_of("plates", number).realise(ACROSS, DOWN, 0, KIND_TEXEL)
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
        maps = kind_of(kind, number).realise(ACROSS, DOWN, 1, KIND_TEXEL)
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
    found = kind_of(name, 1).realise(ACROSS, DOWN, 3, KIND_TEXEL).specular.mean((1, 2)).numpy()
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
        maps = kind_of(kind, 7).realise(48, 32, 1, KIND_TEXEL)
        assert maps.stacked().mean((1, 2)).tolist() == pytest.approx(before, rel=1e-6, abs=1e-12)


def test_a_bench_accepts_them_by_name():
    found = subjects(["gold", "anodised:7"])
    assert [one.name for one in found] == ["gold", "anodised:7"]
    shot = render_rectified(found[0].pieces(11)(64, 48, 2.0 / 64), found[0].setup)
    bright = shot[:, shot.mean(0) > 0.5 * shot.mean(0).max()].mean(1).numpy()
    assert bright / bright.max() == pytest.approx(METAL_F0["gold"], rel=0.05)


FIELD_TEXEL = 2.0 / 256.0
CANVAS = Canvas(256, 192, FIELD_TEXEL, seed=3)
SPECTRUM = Spectrum(coarse=0.1, fine=0.03)


def test_noise_has_the_unit_it_promises():
    field = noise(CANVAS, "a", SPECTRUM)
    assert abs(field.mean()) < 1e-12
    assert field.std() == pytest.approx(1.0, abs=0.1)


def test_bumps_have_unit_slope():
    down, right = np.gradient(bumps(CANVAS, "a", SPECTRUM), FIELD_TEXEL)
    assert math.sqrt((down**2 + right**2).mean()) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_a_finer_grid_shows_the_same_noise_and_cells(angle):
    """Photographs are shaded finer than the true maps are stored."""
    fine = Canvas(3 * 256, 3 * 192, FIELD_TEXEL / 3, seed=3)
    grain = Spectrum(coarse=0.1, fine=0.03, stretch=3.0, angle=angle)
    coarse_noise, fine_noise = noise(CANVAS, "a", grain), noise(fine, "a", grain)
    np.testing.assert_allclose(fine_noise[1::3, 1::3], coarse_noise, atol=1e-9)
    coarse_cells = cells(CANVAS, "c", 0.05, angle=angle, stretch=2.0)
    fine_cells = cells(fine, "c", 0.05, angle=angle, stretch=2.0)
    np.testing.assert_allclose(fine_cells.nearest[1::3, 1::3], coarse_cells.nearest, atol=1e-9)


def test_labels_and_seeds_are_independent():
    first = noise(CANVAS, "a", SPECTRUM)
    for other in (
        noise(CANVAS, "b", SPECTRUM),
        noise(Canvas(256, 192, FIELD_TEXEL, seed=4), "a", SPECTRUM),
    ):
        assert abs(np.corrcoef(first.ravel(), other.ravel())[0, 1]) < 0.2


def test_grain_runs_along_its_angle():
    """Stretched along x, neighbours along x are more alike than neighbours along y."""
    field = noise(CANVAS, "a", Spectrum(0.1, 0.03, stretch=5.0, angle=0.0))
    assert np.diff(field, axis=1).std() < 0.5 * np.diff(field, axis=0).std()
    upright = noise(CANVAS, "a", Spectrum(0.1, 0.03, stretch=5.0, angle=math.pi / 2))
    assert np.diff(upright, axis=0).std() < 0.5 * np.diff(upright, axis=1).std()


def test_nearest_cell_is_the_nearest():
    """Against every point by brute force; the search looks at nine squares only."""
    found = cells(CANVAS, "c", 0.1, jitter=0.8)
    points = np.array(
        [
            [
                (c + 0.5) * FIELD_TEXEL - found.offset[0][r, c] * 0.1,
                (r + 0.5) * FIELD_TEXEL - found.offset[1][r, c] * 0.1,
            ]
            for r in range(0, 192, 2)
            for c in range(0, 256, 2)
        ]
    )
    points = np.unique(points.round(9), axis=0)
    x, y = np.broadcast_arrays(CANVAS.x, CANVAS.y)
    distance = np.hypot(x[..., None] - points[:, 0], y[..., None] - points[:, 1]).min(axis=-1)
    inner = (slice(16, -16), slice(16, -16))
    np.testing.assert_allclose(found.nearest[inner] * 0.1, distance[inner], atol=1e-8)
    assert (found.second >= found.nearest).all()


@pytest.mark.parametrize("over", [1, 2, 3])
def test_weave_alternates(over):
    u, v = np.meshgrid(np.arange(12) + 6.5, np.arange(12) + 6.5)
    threads = weave(u, v, over=over)
    column, row = threads.column, threads.row
    np.testing.assert_array_equal(threads.warp_on_top, (column + row) % (2 * over) < over)
