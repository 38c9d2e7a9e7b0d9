"""The compiled loops are the plain ones of tests/relight/plain."""

from dataclasses import replace

import loop_calls
import numpy as np
import plain.area
import plain.environment
import plain.parallax
import plain.relief
import plain.shadows
import pytest
import torch
from example.exemplars import an_example
from plain.horizons import find_horizons
from plain.lobes import ggx_smith, schlick_weight
from plain.visible_normals import lobe_of
from relight_samples import bumpy

from matcap.api import relight
from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError
from matcap.field.plane import Rectangle
from matcap.files.exr import write_exr
from matcap.relight.block import Block, Hits, ShadingContext, to_frame
from matcap.relight.camera import dot, lattice, scale, subtract, vec
from matcap.relight.effects import area, direct, environment
from matcap.relight.effects import relief as parallax
from matcap.relight.effects.multiscatter import albedo
from matcap.relight.environment_map import environment_of
from matcap.relight.loops import library
from matcap.relight.plan import Budget, Plan, Step, Tally
from matcap.relight.relief import COARSENESS, Horizons, Relief
from matcap.relight.scene import (
    EnvironmentLight,
    Film,
    PointLight,
    RectangleLight,
    Scene,
    SphereLight,
)
from matcap.relight.texture import Sampler, SurfaceSample, Texture

LIGHTS = (
    RectangleLight((-0.8, 0.5, 0.9), (0.8, -0.5, -0.9), size=(0.9, 0.5), radiance=(2.0,) * 3),
    SphereLight((0.7, 0.2, 0.5), 0.3, (2.0,) * 3),
)
COUNT = 400
EVERY = ("diffuse", "specular", "falloff", "area", "shadows", "multiscatter", "interreflection")


@pytest.fixture(scope="module")
def relief() -> Relief:
    """Steep enough for every horizon to matter, and not square."""
    return Relief(Texture.from_maps(bumpy(44, 32, seed=4, relief=0.25)), 1.0, 1.0)


@pytest.fixture(scope="module")
def whole(relief):
    """Horizons of the whole of it."""
    return find_horizons(relief)


def scattered(count, seed=0):
    """Places anywhere, beyond the material's border too."""
    generator = np.random.default_rng(seed)
    return generator.uniform(-3.0, 3.0, (2, count)), generator


def directions(generator, count, *, tilt=1.0):
    towards = generator.normal(size=(3, count)).astype(np.float32)
    towards[2] = np.abs(towards[2]) * tilt
    return loop_calls.unit(tuple(towards))


def pixels(relief, generator, *, framed=False, effects=EVERY, count=COUNT, rough=(0.05, 1.0)):
    """A block of places on the relief, seen and lit from anywhere."""
    u, v = generator.uniform(-1.5, 1.5, (2, count))
    height = relief.at(u, v)
    normal, to_view = directions(generator, count, tilt=3.0), directions(generator, count)
    # Where a view turns its back there is nothing to add.
    backwards = dot(normal, to_view) < 0.01
    to_view = tuple(np.where(backwards, n, v) for n, v in zip(normal, to_view, strict=True))
    alpha = generator.uniform(*rough, count).astype(np.float32)
    frame = None
    if framed:
        axis, other = directions(generator, count), directions(generator, count)
        side = loop_calls.unit(tuple(np.cross(axis, other, axis=0)))
        frame = (side, tuple(np.cross(axis, side, axis=0)), axis)
    point = (u.astype(np.float32), v.astype(np.float32), height)
    hits = Hits(point, frame, (u, v), to_view, None, np.zeros(count, np.float32))
    colours = generator.uniform(0.0, 1.0, (6, count)).astype(np.float32)
    sample = SurfaceSample(tuple(colours[:3]), tuple(colours[3:]), alpha, normal)
    plan = Plan(tuple(Step(one, True, 0.0, "") for one in effects), 1e-4)
    context = ShadingContext(
        Scene(), Sampler(relief.texture, 1.0), relief, plan, (), Horizons(relief), 144,
        None, Tally((count, 1)),
    )  # fmt: skip
    return Block(context, hits, height, sample, np.zeros(count, dtype=int))


def test_a_pixel_alone_equals_the_same_pixel_in_a_block():
    """One hit is an array of one place, which is no grid of texels."""
    sampler = Sampler(Texture.from_maps(bumpy(8, 8)), 1.0)
    u, v = (np.array([0.013, 0.4], np.float32) for _ in range(2))
    alone, beside = sampler.read((u[:1], v[:1])), sampler.read((u, v))
    for one, other in zip(
        (*alone.diffuse, alone.alpha, *alone.normal),
        (*beside.diffuse, beside.alpha, *beside.normal),
        strict=True,
    ):
        assert one == pytest.approx(other[:1])


def shone(block, rays):
    """(3, N) radiance and (9, N) flow of rays: unit vectors and irradiance, all of radiance 1."""
    total, flow = np.zeros((3, COUNT)), np.zeros((9, COUNT))
    sample = block.sample
    for to_light, received in rays:
        received = received * (to_light[2] > 0.0)
        n_dot_l = np.maximum(dot(sample.normal, to_light), np.float32(0.0))
        lobe, l_dot_h = ggx_smith(
            sample.normal, block.hits.to_view, to_light, block.n_dot_v, n_dot_l, sample.alpha
        )
        weight = schlick_weight(l_dot_h)
        lost = albedo().missing(albedo().near(sample.alpha), n_dot_l)
        for c in range(3):
            f0 = sample.specular[c]
            reflected = sample.diffuse[c] / np.pi + lobe * (f0 + (1.0 - f0) * weight)
            total[c] += (reflected + block.strength[c] * lost) * n_dot_l * received
            flow[3 * c : 3 * c + 3] += np.stack(scale(to_light, received))
    return total, flow


def close(found, expected, share=3e-4):
    np.testing.assert_allclose(found, expected, rtol=share, atol=share * np.abs(expected).mean())


@pytest.mark.parametrize("far", [False, True])
def test_compiled_shadows_equal_the_plain_ones(relief, far):
    (u, v), generator = scattered(4000)
    height, towards = relief.at(u, v), directions(generator, 4000, tilt=0.5)
    distance = None if far else generator.uniform(0.05, 1.0, u.shape).astype(np.float32)
    expected = plain.shadows.lit(relief, (u, v), height, towards, distance)
    found = loop_calls.lit(relief, (u, v), height, towards, distance)
    assert 0.1 < expected.mean() < 0.9 and (found != expected).mean() <= 1e-3


@pytest.mark.parametrize("endless", [False, True])
def test_no_ray_is_hidden_above_a_clear_tangent(relief, endless):
    """From anywhere in a texel, along any azimuth; and half as high some are."""
    relief = replace(relief, endless=endless)
    (u, v), generator = scattered(6000)
    column, row = (np.rint(one).astype(int) for one in relief.texels(u, v))
    inside = (column >= 0) & (column < 44) & (row >= 0) & (row < 32)
    u, v, at = u[inside], v[inside], (row * 44 + column)[inside]
    tangent, turn = relief.clear_tangents[at], generator.uniform(0.0, 2.0 * np.pi, u.size)
    hidden = []
    for share in (1.0001, 0.5):
        towards = loop_calls.unit((np.cos(turn), np.sin(turn), share * tangent))
        towards = tuple(one.astype(np.float32) for one in towards)
        hidden.append(~loop_calls.lit(relief, (u, v), relief.at(u, v), towards, None))
    assert not hidden[0].any() and hidden[1].mean() > 0.03


def test_compiled_heights_equal_the_plain_ones(relief):
    (u, v), _ = scattered(4000)
    np.testing.assert_allclose(relief.at(u, v), plain.relief.at(relief, u, v), atol=1e-7)


def test_compiled_parallax_equals_the_plain_one(relief):
    place, generator = scattered(3000)
    to_view = directions(generator, 3000, tilt=2.0)
    ours, theirs = (
        form.shift(relief, tuple(place), to_view) for form in (parallax, plain.parallax)
    )
    # Rays that graze a ridge may or may not meet it.
    near = np.abs(ours[1] - theirs[1]) <= 1e-5
    assert near.mean() >= 0.999
    np.testing.assert_allclose(ours[0][0][near], theirs[0][0][near], atol=1e-3)


@pytest.mark.parametrize("framed", [False, True])
def test_compiled_point_lights_equal_the_plain_ones(relief, framed):
    block = pixels(relief, np.random.default_rng(5), framed=framed)
    light = PointLight((0.3, -0.4, 0.6), (1.0, 1.0, 1.0))
    offset = subtract(vec(light.position), block.hits.point)
    distance = np.sqrt(dot(offset, offset))
    towards = to_frame(scale(offset, 1.0 / distance), block.hits.frame)
    lit = plain.shadows.lit(block.context.relief, block.hits.place, block.height, towards, distance)
    assert 0.1 < lit.mean() < 0.95
    total, flow = shone(block, [(towards, lit / distance**2)])
    direct.add(block, light)
    close(block.total, total)
    close(block.vector_irradiance, flow)


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("framed", [False, True])
@pytest.mark.parametrize("shaded", [False, True])
def test_compiled_area_lights_equal_the_plain_ones(relief, light, framed, shaded):
    """Each pixel by its own rule, with the share that arrives of each part."""
    effects = EVERY if shaded else tuple(one for one in EVERY if one != "shadows")
    generator = np.random.default_rng(2)
    # So rough that none is sampled.
    block = pixels(relief, generator, framed=framed, effects=effects, rough=(0.7, 1.0))
    hits, shadow = block.hits, np.ones((16, COUNT))
    if shaded:
        arriving, above = np.zeros((2, 16, COUNT))
        for node in plain.area.nodes(light, area.rule(light, 4), hits.point, hits.frame):
            risen = node.to_light[2] > 0.0
            lit = plain.shadows.lit(relief, hits.place, block.height, node.to_light, node.distance)
            arriving[node.cell] += lit & risen
            above[node.cell] += risen
        shadow = np.where(above > 0.0, arriving / np.maximum(above, 1.0), 1.0)
        assert 0.1 < shadow.mean() < 0.95
    orders = plain.area.orders(light, hits.point, block.sample.alpha)
    area.add(block, light)
    for order in np.unique(orders):
        assert order > 0
        parted = max(4 * -(-order // 4), 12)
        rule = area.rule(light, parted, parts=True) if shaded else area.rule(light, int(order))
        nodes = plain.area.nodes(light, rule, hits.point, hits.frame)
        rays = [(node.to_light, node.received * shadow[node.cell]) for node in nodes]
        total, flow = (one[:, orders == order] for one in shone(block, rays))
        # A shadow ray that grazes a ridge may be on either side of it.
        off = np.abs(block.total[:, orders == order] / 2.0 - total).max(axis=0)
        assert np.quantile(off / np.abs(total).mean(), 0.97) <= 5e-4
        off = np.abs(block.vector_irradiance[:, orders == order] / 2.0 - flow).max(axis=0)
        assert np.quantile(off / np.abs(flow).mean(), 0.97) <= 5e-4


@pytest.mark.parametrize("light", LIGHTS)
def test_adaptively_sampled_area_lights_are_near_the_finest(relief, light):
    """As fine as a pixel asks for is as good as as fine as can be, for neighbours, too."""
    plain, chosen = (pixels(relief, np.random.default_rng(2), rough=(0.3, 1.0)) for _ in range(2))
    chosen.context = replace(chosen.context, budget=Budget(1e-3, Film(), frozenset()))
    area.add(plain, light)
    area.add(chosen, light)
    for found, expected in (
        (chosen.total, plain.total),
        (chosen.vector_irradiance, plain.vector_irradiance),
    ):
        off = np.abs(found - expected).max(axis=0) / np.abs(expected).mean()
        assert np.quantile(off, 0.9) <= 2e-3 and off.max() <= 0.1


def test_a_light_too_large_for_rules_in_a_near_mirror_is_sampled(relief):
    """The lobe at 144 of its directions, each of which meets the light or does not."""
    light = SphereLight((0.2, 0.1, 1.6), 1.2, (1.0, 1.0, 1.0))
    effects = ("specular", "area")
    block = pixels(relief, np.random.default_rng(6), effects=effects, rough=(0.02, 0.02))
    lobe = lobe_of(block.sample, block.hits.to_view, block.n_dot_v)
    assert not plain.area.orders(light, block.hits.point, block.sample.alpha).any()
    expected, offset = np.zeros((3, COUNT)), subtract(vec(light.position), block.hits.point)
    for point in lattice(144):
        one = lobe.mirrored(point)
        sideways = np.cross(np.stack(one.to_light), np.stack(offset), axis=0)
        met = ((sideways**2).sum(axis=0) <= 1.2**2) & (dot(one.to_light, offset) > 0)
        share = one.weight * (met & (one.to_light[2] > 0.0))
        for c, f0 in enumerate(block.sample.specular):
            expected[c] += share * (f0 + (1.0 - f0) * one.fresnel)
    area.add(block, light)
    assert expected.max() > 0.3
    assert np.quantile(np.abs(block.total - expected).max(axis=0), 0.98) <= 1e-3


@pytest.mark.parametrize("texels", [np.arange(44 * 32), np.array([1407, 0, 700, 700, 47])])
def test_horizons_are_those_of_the_whole_to_the_last_bit(relief, whole, texels):
    near, (row, column) = Horizons(relief), np.divmod(texels, 44)
    place = column.astype(float), row.astype(float)
    near.compute(*place)
    np.testing.assert_array_equal(near.tangents[texels], whole.tangents[texels])
    np.testing.assert_allclose(near.open[texels, :1], whole.open[texels], atol=1e-6)
    sent = near.transfer(*place, None, fine=True)
    np.testing.assert_allclose(sent[texels], whole.bounced[texels], atol=1e-6)
    np.testing.assert_array_equal(near.tangents[texels], whole.tangents[texels])


def test_no_transfer_is_longer_than_its_bound_nor_a_coarse_sum_far_off(relief, whole):
    row, column = np.divmod(np.arange(44 * 32), 44)
    near = Horizons(relief)
    coarse = near.transfer(column.astype(float), row.astype(float), None, fine=False)
    most = near.open[:, 1:] * np.array(relief.texture.brightest)
    vectors = whole.bounced.reshape(-1, 3, 3)
    assert (np.linalg.norm(vectors, axis=2) <= most + 1e-6).all()
    share = np.linalg.norm(coarse.reshape(-1, 3, 3) - vectors, axis=2) / np.maximum(most, 1e-3)
    assert np.median(share) <= 0.5 * COARSENESS and share.max() <= 4.0 * COARSENESS


def sky_of(tmp_path):
    """Surroundings that differ, smoothly and at an edge."""
    row, column = np.mgrid[0:32, 0:64]
    picture = 1.0 + np.sin(column / 64 * 2 * np.pi) * np.sin(row / 32 * np.pi) + (row < 12)
    write_exr(tmp_path / "sky.exr", picture[..., None].repeat(3, 2).astype("f4"), half=False)
    return EnvironmentLight(tmp_path / "sky.exr")


@pytest.mark.parametrize("hides", [False, True])
@pytest.mark.parametrize("even", [False, True])
@pytest.mark.parametrize("adaptive", [False, True])
def test_compiled_mirrored_environments_equal_the_plain_ones(
    relief, whole, tmp_path, hides, even, adaptive
):
    """All directions, or those alone that are not above the highest horizon: the same."""
    light = EnvironmentLight(radiance=(1.0,) * 3) if even else sky_of(tmp_path)
    sky = environment_of(light)
    block = pixels(relief, np.random.default_rng(3), count=200, rough=(0.1, 1.0))
    lobe = lobe_of(block.sample, block.hits.to_view, block.n_dot_v)
    texel = plain.relief.nearest(relief, *block.hits.place)
    tangents = whole.tangents[texel] if hides else None
    if even:
        expected = -plain.environment.hidden(lobe, 144, tangents)[:, None]
    else:
        expected = plain.environment.differing(sky, lobe, 144, tangents)
    horizons = block.context.horizons
    horizons.compute(block.column, block.row)
    horizon = horizons.as_c(adaptive=adaptive)
    if not hides:
        horizon.tangents = None
    found = environment._sampled(block, sky, horizon, np.arange(200, dtype=np.int32))
    assert np.abs(expected).max() > 0.1
    # A direction that grazes a horizon may be on either side of it.
    off = np.abs(found - expected).max(axis=(0, 1))
    assert np.quantile(off, 0.98) <= 3e-5 and off.max() <= 0.05


def test_missing_compiled_loops_are_one_sentence(monkeypatch):
    library.built.cache_clear()
    monkeypatch.setattr("matcap.files.process.EXTENSION_SUFFIXES", [])
    try:
        with pytest.raises(MatcapError, match="were not built when matcap was installed; install"):
            relight(bumpy(8, 8), Scene(Film(4, 4), lights=(PointLight((0.0, 0.0, 2.0)),)))
    finally:
        library.built.cache_clear()


def test_a_field_without_torch_is_the_texture_of_its_maps():
    """To the last bit: slopes by way of the unit normal, one-sided at the borders."""
    example = an_example()
    stacked = example.maps(3, Rectangle(0, 0, 40, 30), None)
    texel_size = example.exemplar.texel_size
    found = Texture.from_stacked(stacked, texel_size)
    maps = MapSet.from_stacked(torch.from_numpy(stacked), texel_size, periodic=False)
    expected = Texture.from_maps(maps)
    for name in ("diffuse", "specular", "roughness", "height", "slopes"):
        assert np.array_equal(getattr(found, name), getattr(expected, name))
    assert (found.texel_size, found.periodic) == (expected.texel_size, expected.periodic)
