"""The compiled loops are the plain ones, which every other test of pictures holds to everything."""

import numpy as np
import pytest
from relight_samples import bumpy
from test_relight_tiles import difference, scattered

from matcap.relight import compiled
from matcap.relight.effects import area, environment, parallax, shadows
from matcap.relight.effects.visibility import HorizonTest
from matcap.relight.horizons import find_horizons
from matcap.relight.lobes import ggx_smith, schlick_weight
from matcap.relight.relief import Relief
from matcap.relight.sampling import Sampler, SurfaceSample
from matcap.relight.scene import (
    EnvironmentLight,
    Film,
    PointLight,
    RectangleLight,
    Scene,
    SphereLight,
    Surface,
)
from matcap.relight.surfaces.hits import Hits
from matcap.relight.tables import albedo
from matcap.relight.texel_horizons import TexelHorizons
from matcap.relight.texture import Texture
from matcap.relight.vectors import dot, unit
from matcap.relight.visible_normals import lobe_of

pytestmark = pytest.mark.skipif(compiled.kernel() is None, reason="the kernel was not built")

LIGHTS = (
    RectangleLight((-0.8, 0.5, 0.9), (0.8, -0.5, -0.9), size=(0.9, 0.5), radiance=(2.0,) * 3),
    SphereLight((0.7, 0.2, 0.5), 0.3, (2.0,) * 3),
)
COUNT = 400


@pytest.fixture(scope="module")
def relief() -> Relief:
    return Relief(Texture.from_maps(bumpy(48, 32, seed=4, relief=0.25)), 1.0, 1.0)


@pytest.fixture
def plain(monkeypatch):
    """The plain form of whatever chooses, for as long as a function runs."""

    def run(work):
        with monkeypatch.context() as patch:
            patch.setattr(compiled, "kernel", lambda: None)
            return work()

    return run


def directions(generator, count, *, tilt=1.0):
    towards = generator.normal(size=(3, 1, count)).astype(np.float32)
    towards[2] = np.abs(towards[2]) * tilt
    return unit(tuple(towards))


def pixels(relief, generator, *, framed=False):
    """Places on the relief, seen and lit from anywhere."""
    u, v = generator.uniform(-1.5, 1.5, (2, 1, COUNT))
    height = relief.at(u, v)
    normal, to_view = directions(generator, COUNT, tilt=3.0), directions(generator, COUNT)
    alpha = generator.uniform(0.05, 1.0, (1, COUNT)).astype(np.float32)
    frame = None
    if framed:
        axis, other = directions(generator, COUNT), directions(generator, COUNT)
        side = unit(tuple(np.cross(axis, other, axis=0)))
        frame = (side, tuple(np.cross(axis, side, axis=0)), axis)
    point = (u.astype(np.float32), v.astype(np.float32), height)
    hits = Hits(point, frame, (u, v), to_view, None, np.full((1, 1), 0.01, np.float32))
    shelter = relief.shelter(u, v, height)
    n_dot_v = np.maximum(dot(normal, to_view), np.float32(0.01))
    return compiled.LitPixels(hits, height, shelter, normal, n_dot_v, alpha, albedo().near(alpha))


@pytest.mark.parametrize("far", [False, True])
def test_shadows(relief, far):
    (u, v), generator = scattered(4000)
    height, towards = relief.at(u, v), directions(generator, 4000, tilt=0.5)
    distance = None if far else generator.uniform(0.05, 1.0, u.shape).astype(np.float32)
    expected = shadows.lit(relief, (u, v), height, towards, distance)
    found = compiled.lit(relief, (u, v), height, towards, distance)
    assert 0.1 < expected.mean() < 0.9
    assert (found != expected).mean() <= 1e-3


def test_parallax(relief):
    place, generator = scattered(3000)
    to_view = directions(generator, 3000, tilt=2.0)
    ours, theirs = (parallax.shift(relief, tuple(place), to_view, quick=q) for q in (True, False))
    # Rays that graze a ridge may or may not meet it.
    near = np.abs(ours[1] - theirs[1]) <= 1e-5
    assert near.mean() >= 0.999
    np.testing.assert_allclose(ours[0][0][near], theirs[0][0][near], atol=1e-3)


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("framed", [False, True])
def test_shadows_of_the_parts_of_a_light(relief, light, framed):
    some = pixels(relief, np.random.default_rng(1), framed=framed)
    rule = area.rule(light, 4)
    arriving, above = np.zeros((2, 16, COUNT))
    for node in area.nodes(light, rule, some.hits.point, some.hits.frame):
        risen = node.to_light[2] > 0.0
        lit = shadows.lit(relief, some.hits.place, some.height, node.to_light, node.distance)
        arriving[node.cell] += (lit & risen)[0]
        above[node.cell] += risen[0]
    expected = np.where(above > 0.0, arriving / np.maximum(above, 1.0), 1.0)
    found = compiled.parts_lit(relief, light, rule, some, COUNT)
    assert 0.1 < expected.mean() < 0.95
    assert (found != expected).mean() <= 2e-3


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("framed", [False, True])
@pytest.mark.parametrize("shaded", [False, True])
def test_rules_of_area_lights(relief, light, framed, shaded):
    generator = np.random.default_rng(2)
    some = pixels(relief, generator, framed=framed)
    rule = area.rule(light, 12, parts=True)
    shadow = generator.uniform(size=(16, COUNT)).astype(np.float32) if shaded else None
    expected = np.zeros((7, 1, COUNT))
    for node in area.nodes(light, rule, some.hits.point, some.hits.frame):
        received = node.received * (node.to_light[2] > 0.0)
        if shadow is not None:
            received = received * shadow[node.cell]
        n_dot_l = np.maximum(dot(some.normal, node.to_light), np.float32(0.0))
        lobe, l_dot_h = ggx_smith(
            some.normal, some.hits.to_view, node.to_light, some.n_dot_v, n_dot_l, some.alpha
        )
        lobe *= n_dot_l * received
        expected[0] += n_dot_l * received
        expected[1] += lobe
        expected[2] += lobe * schlick_weight(l_dot_h)
        expected[3] += albedo().missing(some.near, n_dot_l) * n_dot_l * received
        expected[4:] += np.stack([c * received for c in node.to_light])
    found = compiled.rule_sums(light, rule, some, COUNT, shadow, lobe=True)
    sums = (found.irradiance, found.mirrored, found.fresnel, found.lost, *found.flow)
    for one, other in zip(sums, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=2e-4, atol=2e-4 * np.abs(other).mean())


def test_horizons_and_what_neighbours_send(relief, plain):
    texels = np.random.default_rng(3).permutation(48 * 32)[:700]

    def found():
        near = TexelHorizons(relief)
        near.see(texels)
        every = near.tangents[texels], near.open[texels], near.coarse(texels)[texels]
        return (*every, near.steepest(texels), near.fine(texels))

    ours, theirs = found(), plain(found)
    np.testing.assert_array_equal(ours[0], theirs[0])
    for one, other in zip(ours[1:], theirs[1:], strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)


@pytest.mark.parametrize("hides", [False, True])
def test_what_of_even_surroundings_is_hidden(relief, plain, hides):
    (u, v), generator = scattered(600)
    horizons = find_horizons(relief, bounces=False, run=lambda work, all_: [*map(work, all_)])
    test = HorizonTest(horizons.tangents, Sampler(relief.texture, 1.0).nearest((u, v)))
    normal, to_view = directions(generator, 600, tilt=2.0), directions(generator, 600)
    alpha = generator.uniform(0.02, 1.0, u.shape).astype(np.float32)
    lobe = lobe_of(SurfaceSample((alpha,), (alpha,), alpha, normal), to_view, dot(normal, to_view))
    highest = np.full(u.shape, 1.0 if hides else 0.0, dtype=np.float32)

    def found():
        return environment.hidden(lobe, 144, test if hides else None, highest)

    for one, other in zip(found(), plain(found), strict=True):
        assert other.max() > 0.1
        np.testing.assert_allclose(one, other, atol=2e-5)


def test_pictures(plain):
    """With every kind of light, compiled and not: both what all effects make of it."""
    lights = (
        *LIGHTS,
        PointLight((1.0, 0.4, 0.4), (0.5,) * 3),
        EnvironmentLight(radiance=(0.2,) * 3),
    )
    scene = Scene(Film(40, 30), None, Surface(size=None), lights)
    maps = bumpy(64, 48, relief=0.06)
    for off, _ in (difference(maps, scene), plain(lambda: difference(maps, scene))):
        assert np.abs(off).max() <= 1.0
