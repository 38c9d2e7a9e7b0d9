"""Pictures by the renderer: physics, lobes, colour."""

import math
from dataclasses import replace

import loop_calls
import numpy as np
import pytest
import torch
from loop_calls import lobe
from plain.lobes import ggx_smith, schlick_weight
from relight_samples import bumpy, coloured, flat

from matcap.api import relight
from matcap.brdf import cook_torrance as reference
from matcap.brdf.maps import MapSet
from matcap.relight.camera import dot, vec
from matcap.relight.effects import multiscatter
from matcap.relight.effects import relief as parallax
from matcap.relight.effects.multiscatter import albedo
from matcap.relight.relief import Horizons, Relief
from matcap.relight.render import Renderer
from matcap.relight.scene import (
    Camera,
    DirectionalLight,
    EnvironmentLight,
    Film,
    PointLight,
    RectangleLight,
    Scene,
    SphereLight,
    Surface,
)
from matcap.relight.texture import Texture, alpha_of

# What physics demands of the effects, each against a closed form or a brute force.


def mirrored_rule(view, alpha, order=600):
    """Directions and solid angles that follow the lobe: normals by GGX's own distribution."""
    s = ((np.arange(order) + 0.5) / order)[:, None]
    u, step = 1.0 - s**4, 4.0 * s**3 / order**2  # crowded where the lobe's long tail is
    azimuth = (np.arange(order) + 0.5) * 2.0 * math.pi / order
    cosine = np.sqrt((1.0 - u) / (1.0 + (alpha**2 - 1.0) * u))
    sine = np.sqrt(1.0 - cosine**2)
    x, y = sine * np.cos(azimuth), sine * np.sin(azimuth)
    z = np.broadcast_to(cosine, x.shape)
    along = x * view[0] + y * view[1] + z * view[2]
    spread = 1.0 + (alpha**2 - 1.0) * z**2
    density = alpha**2 / (math.pi * spread**2) * z / (4.0 * np.maximum(along, 1e-12))
    to_light = tuple(2.0 * along * h - v for h, v in zip((x, y, z), view, strict=True))
    return to_light, np.where((to_light[2] > 1e-9) & (along > 0.0), step / density, 0.0)


def lobe_albedo(mu, roughness):
    """Scale and bias of the albedo F0 scale + bias of a single bounce, integrated directly."""
    view = (math.sqrt(1.0 - mu * mu), 0.0, mu)
    to_light, solid = mirrored_rule(view, roughness**2)
    to_light = tuple(c.ravel() for c in (*to_light[:2], np.maximum(to_light[2], 1e-9)))
    up = (0.0, 0.0, 1.0)
    normal, to_view = (tuple(np.full(solid.size, c) for c in one) for one in (up, view))
    lobe, weight = loop_calls.lobe(normal, to_view, to_light, np.full(solid.size, roughness**2))
    light = lobe * to_light[2] * solid.ravel()
    return ((1.0 - weight) * light).sum(), (weight * light).sum()


def compensation(mu, roughness):
    """What a white (F0 = 1) surface reflects by further bounces: a lobe that is round."""
    nodes, weights = np.polynomial.legendre.leggauss(200)
    cosine = ((nodes + 1.0) / 2.0) ** 2
    slender = (nodes + 1.0) / 2.0 * weights  # d cosine
    near = albedo().near(np.full(200, roughness**2))
    strength, _ = multiscatter.terms(np.ones(1), near[:1], np.full(1, mu))
    return (2.0 * math.pi * strength[0] * albedo().missing(near, cosine) * cosine * slender).sum()


def tabulated(mu, roughness):
    tables = albedo()
    rows = tables.rows(np.full(1, roughness**2))
    return float(tables.lookup(tables.fine_total, np.full(1, mu), rows)[0])


@pytest.mark.parametrize("roughness", [0.05, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0])
@pytest.mark.parametrize("mu", [0.02, 0.1, 0.2, 0.5, 0.8, 1.0])
def test_a_white_lobe_with_compensation_reflects_all_light(roughness, mu):
    single = sum(lobe_albedo(mu, roughness))
    assert single <= 1.001 and single == pytest.approx(tabulated(mu, roughness), abs=5e-3)
    assert single + compensation(mu, roughness) == pytest.approx(1.0, abs=0.02)


def test_compensation_is_reciprocal():
    mu_v, mu_l, alpha = np.random.default_rng(0).random((3, 1000))

    def lobe(view, light):
        near = albedo().near(alpha)
        strength, _ = multiscatter.terms(np.full(1000, 0.9), near, view)
        return strength * albedo().missing(near, light)

    np.testing.assert_allclose(lobe(mu_v, mu_l), lobe(mu_l, mu_v), rtol=1e-6, atol=1e-9)


def test_an_even_sky_on_white_diffuse_is_as_bright_as_the_sky():
    """Lambert: radiance out is radiance in. And a white rough metal does nearly the same."""
    sky = (EnvironmentLight(radiance=(0.25, 0.5, 1.0)),)
    scene = Scene(Film(8, 6), None, Surface(), sky)
    plain = relight(flat(diffuse=1.0, specular=0.0), scene, effects="none,+diffuse")
    np.testing.assert_allclose(plain, np.broadcast_to([0.25, 0.5, 1.0], plain.shape), rtol=1e-6)
    metal = relight(flat(diffuse=0.0, specular=1.0, roughness=0.9), scene, effects="all")
    np.testing.assert_allclose(metal, np.broadcast_to([0.25, 0.5, 1.0], metal.shape), rtol=0.02)


@pytest.mark.parametrize(
    "light",
    [
        PointLight((0.3, 0.2, 0.5), (1.0, 2.0, 3.0)),
        DirectionalLight((1.0, 0.3, 0.4), (0.5, 0.4, 0.3)),
        SphereLight((0.5, 0.2, 0.8), 0.3, (1.0, 2.0, 3.0)),
        RectangleLight((0.5, 0.2, 0.8), (-0.5, -0.2, -0.8), size=(0.5, 0.4)),
        EnvironmentLight(radiance=(0.1, 0.2, 0.3)),
    ],
)
def test_doubling_a_light_doubles_the_picture(light):
    maps = bumpy(24, 18, relief=0.1)
    one = Scene(Film(24, 18), None, Surface(), (light,))
    two = Scene(Film(24, 18), None, Surface(), (light, light))
    single, double = (relight(maps, scene, effects="all") for scene in (one, two))
    np.testing.assert_allclose(double, 2.0 * single, rtol=2e-5)


def test_rectangle_light_irradiance_in_closed_form():
    """A unit square at unit height above its corner point: Lambert's polygon formula."""
    light = RectangleLight((0.5, 0.5, 1.0), (0.0, 0.0, -1.0), size=(1.0, 1.0))
    scene = Scene(Film(1, 1), None, Surface(), (light,))
    picture = relight(flat(1, 1, diffuse=1.0), scene, effects="none,+diffuse,+area,+falloff")
    # E / L = (1/2) sum of edge angles times their planes' slope; the square's two far edges.
    edge = math.atan(1.0 / math.sqrt(2.0)) / math.sqrt(2.0)
    assert picture[0, 0, 0] * math.pi == pytest.approx(edge, rel=2e-6)


def test_a_far_area_light_is_a_point():
    maps = bumpy(24, 18)
    small = SphereLight((10.0, 5.0, 30.0), 0.05, (4e5, 4e5, 4e5))
    power = 4e5 * math.pi * 0.05**2
    point = PointLight(small.position, (power, power, power))

    def picture(light):
        return relight(maps, Scene(Film(24, 18), None, Surface(displacement=0.0), (light,)))

    np.testing.assert_allclose(picture(small), picture(point), rtol=1e-3)


def ridge(height=0.1, width=64) -> Texture:
    """A wall one texel wide along y in the middle of a flat floor, seen by its columns."""
    field = np.zeros((1, 8, width), dtype=np.float32)
    field[0, :, width // 2] = height
    one = np.ones((1, 8, width), dtype=np.float32)
    flat_slopes = np.zeros((2, 8, width), dtype=np.float32)
    return Texture(np.repeat(one, 3, 0), 0 * one, one, field, flat_slopes, 2.0 / width)


def test_the_shadow_of_a_wall_is_as_long_as_geometry_says():
    relief = Relief(ridge(), 1.0, 1.0)
    wall = (32 + 0.5) / 64 * 2 - 1
    u = np.linspace(-0.9, 0.9, 721)[None, :]
    v = np.zeros((1, 1))
    for tangent in (0.25, 0.5, 1.0):
        length = math.hypot(1.0, tangent)
        light = vec((1.0 / length, 0.0, tangent / length))
        lit = loop_calls.lit(relief, (u, v), relief.at(u, np.zeros_like(u)), light, None)[0]
        distance = wall - u[0]  # the light is to the right, shadows fall to the left
        inside = (distance > 2.0 / 64) & (distance < 0.1 / tangent)
        # Beyond the wall's own foot and tip, where its slopes are.
        outside = (distance < -2.0 / 64) | (distance > 0.1 / tangent + 1e-6)
        assert not lit[inside].any() and lit[outside].all()


def test_a_light_between_wall_and_point_is_not_shadowed():
    relief = Relief(ridge(), 1.0, 1.0)
    u, v = np.full((1, 1), -0.2), np.zeros((1, 1))
    light = vec((1.0 / math.hypot(1.0, 0.1), 0.0, 0.1 / math.hypot(1.0, 0.1)))
    zero = np.zeros((1, 1), dtype=np.float32)
    far, near = np.full((1, 1), 5.0), np.full((1, 1), 0.1)
    assert not loop_calls.lit(relief, (u, v), zero, light, far).any()
    assert loop_calls.lit(relief, (u, v), zero, light, near).all()


def sawtooth(*, periodic: bool) -> Texture:
    """A gentle slope that is a cliff where it meets its own repetition."""
    texture = replace(ridge(height=0.0), periodic=periodic)
    texture.height[:] = np.linspace(0.0, 0.2, 64, dtype=np.float32)
    return texture


def test_the_border_of_the_maps_casts_no_shadow():
    """What lies at the right border must not shadow the left one, unless it does lie there."""
    scene = Scene(Film(64, 8), None, Surface(size=None), (DirectionalLight((-1.0, 0.0, 0.5)),))
    effects = "none,+diffuse,+shadows"
    repeating = relight(sawtooth(periodic=True), scene, effects=effects)[4, :, 0]
    piece = relight(sawtooth(periodic=False), scene, effects=effects)[4, :, 0]
    assert not repeating[:5].any() and repeating[-5:].all() and piece.all()
    larger = Scene(scene.film, None, Surface(size=4.0), scene.lights)
    assert not relight(sawtooth(periodic=False), larger, effects=effects)[4].all()


def test_a_pixel_is_as_dark_as_its_shadow_is_large():
    """Large pixels against the mean of small ones: few are black, and all are as dark."""
    maps = bumpy(256, 256, seed=3, relief=0.0)
    maps.height[0] = maps.height.new_tensor(np.random.default_rng(0).normal(0.0, 0.004, (256, 256)))

    def shadow(size):
        light = (DirectionalLight((1.0, 0.3, 0.8)),)
        scene = Scene(Film(size, size), None, Surface(size=None), light)
        effects = ("none,+diffuse,+shadows", "none,+diffuse")
        lit, free = (relight(maps, scene, effects=each)[..., 0] for each in effects)
        return np.where(free > 0.0, lit / np.maximum(free, 1e-9), 1.0)

    fine = shadow(1024).reshape(128, 8, 128, 8).mean(axis=(1, 3))
    coarse = shadow(128)
    assert 0.1 < fine.mean() < 0.9 and coarse.mean() == pytest.approx(fine.mean(), abs=0.02)
    # One ray a pixel is off by sqrt(share (1 - share)): 0.35 and more here.
    assert np.sqrt(((coarse - fine) ** 2).mean()) < 0.6 * np.sqrt((fine * (1.0 - fine)).mean())


def test_parallax_of_a_raised_plane():
    """A flat floor at height h, seen from the side, is displaced by h times the tangent."""
    texture = ridge()
    texture.height[:] = 0.05
    texture.height[0, 0, 0] = 0.0  # some range, far from where it is looked at
    relief = Relief(texture, 1.0, 1.0)
    view = vec((0.6, 0.0, 0.8))
    u, v = np.full((1, 3), 0.3), np.full((1, 3), 0.02)
    (moved, same), height = parallax.shift(relief, (u, v), tuple(np.full((1, 3), c) for c in view))
    np.testing.assert_allclose(height, 0.05, rtol=1e-5)
    np.testing.assert_allclose(moved - u, 0.05 * 0.6 / 0.8, rtol=1e-5)
    np.testing.assert_allclose(same, v)


def test_parallax_hits_lie_on_the_surface_and_on_the_ray():
    relief = Relief(Texture.from_maps(bumpy(32, 24, seed=4, relief=0.2)), 1.0, 1.0)
    u, v = np.random.default_rng(2).uniform(-0.5, 0.5, (2, 1, 500))
    view = tuple(np.full((1, 500), c, dtype=np.float32) for c in (0.3, -0.5, 0.812))
    (hit_u, hit_v), height = parallax.shift(relief, (u, v), view)
    np.testing.assert_allclose(hit_u - u, height * 0.3 / 0.812, atol=1e-3)
    np.testing.assert_allclose(hit_v - v, height * -0.5 / 0.812, atol=1e-3)
    # Nothing of the surface stands between the hit and the camera.
    for t in np.linspace(0.01, 0.3, 100):
        above = height + t * view[2] - relief.at(hit_u + t * view[0], hit_v + t * view[1])
        assert above.min() > -2e-3


def horizons_of(texture):
    """Of all texels; what neighbours send them."""
    row, column = np.mgrid[: texture.size[1], : texture.size[0]].reshape(2, -1).astype(float)
    horizons = Horizons(Relief(texture, 1.0, 1.0))
    return horizons.open[:, 0], horizons.transfer(column, row, None, fine=True)


def test_a_flat_field_sees_the_whole_sky_and_no_neighbours():
    opened, bounced = horizons_of(Texture.from_maps(flat()))
    np.testing.assert_allclose(opened, 1.0, atol=1e-6)
    np.testing.assert_allclose(bounced, 0.0, atol=1e-7)


def test_the_foot_of_an_endless_wall_sees_half_the_sky():
    """Beside a wall that fills elevations up to 80 degrees, (1 + cos 80) / 2 is left."""
    width = 512
    texture = ridge(height=0.0, width=width)
    away = 4
    texture.height[:, :, width // 2 :] = away * texture.texel_size * math.tan(math.radians(80))
    opened, _ = horizons_of(texture)
    foot = opened.reshape(8, width)[4, width // 2 - away]
    assert foot == pytest.approx((1.0 + math.cos(math.radians(80))) / 2.0, abs=0.03)


def test_a_valley_of_given_slope_sees_its_share_of_the_sky():
    """In a v-shaped valley of slope 1 the bottom sees sin 45 degrees of the sky's irradiance."""
    width = 128
    field = np.abs(np.arange(width) - width / 2.0)[None, None].repeat(8, 1).astype(np.float32)
    texture = ridge(width=width)
    texture.height[:] = field * texture.texel_size
    opened, _ = horizons_of(texture)
    # Irradiance between planes at +-45 degrees, long along y: the sine of the half angle.
    bottom = opened.reshape(8, width)[4, width // 2]
    assert bottom == pytest.approx(math.sin(math.pi / 4), abs=0.03)


def test_interreflection_warms_what_faces_a_coloured_wall():
    texture = ridge(height=0.4, width=64)
    texture.diffuse[1:] = 0.0  # all is red
    scene = Scene(Film(64, 8), None, Surface(size=None), (DirectionalLight((-1.0, 0.0, 1.0)),))
    renderer = Renderer(texture, scene)
    with_it = renderer.render(effects="all,-specular,-multiscatter").radiance
    without = renderer.render(effects="all,-specular,-multiscatter,-interreflection").radiance
    gained = (with_it - without)[4]
    assert not gained[:, 1:].any()
    # The wall's lit side faces left, so the floor left of it gains, more when nearer.
    assert gained[28, 0] > gained[20, 0] > gained[8, 0] >= 0.0 and gained[28, 0] > 0.01


# The reflectance of the loops, and of plain NumPy in float64, is matcap.brdf's.


def directions(count, seed):
    """(3, count) unit vectors of the upper hemisphere, float64."""
    vectors = np.random.default_rng(seed).normal(size=(3, count))
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
def test_renderings_equal_the_float64_reference(dtype, limit, roughness):
    to_view, to_light = directions(500, 1), directions(500, 2)
    to_light[:, :250] = to_view[:, :250] * [[-1], [-1], [1]]  # mirrored: the peak
    normal = np.broadcast_to(np.array([[0.0], [0.0], [1.0]]), to_view.shape)
    rough = np.full(500, roughness)
    vectors = (tuple(one.astype(dtype)) for one in (normal, to_view, to_light))
    found = specular(*vectors, rough.astype(dtype), dtype(0.04))
    assert found.dtype == dtype

    def image(array):
        return torch.from_numpy(np.ascontiguousarray(array)).reshape(-1, 1, 500)

    stored = (image(one.astype(dtype).astype(np.float64)) for one in (normal, to_light, to_view))
    f0 = torch.full((1, 1, 500), 0.04, dtype=torch.float64)
    angles = reference.Angles.exact(*stored)
    expected = reference.specular_lobe(f0, image(rough[None]), angles).reshape(-1)
    # In float32 the very peak of a mirror cannot be told from its side.
    keep = slice(250, None) if dtype is np.float32 and roughness < 0.1 else slice(None)
    np.testing.assert_allclose(found[keep], expected.numpy()[keep], rtol=limit)


def test_a_worked_value_is_reproduced():
    """Straight down on roughness 0.5 and F0 0.04: D = 1 / (pi alpha^2), V = 1/4."""
    up = (np.zeros(1), np.zeros(1), np.ones(1))
    expected = 1.0 / (math.pi * 0.25**2) / 4.0 * 0.04
    assert specular(up, up, up, np.full(1, 0.5), 0.04)[0] == pytest.approx(expected, rel=1e-12)


# An F0 with a colour is relit as three materials of one channel each would be, light by light.

GOLD = (1.0, 0.766, 0.336)
COLOUR = torch.tensor(GOLD)[:, None, None]
LIGHTS = {
    "point": PointLight((0.4, 0.3, 1.5), (1.0, 0.7, 1.3)),
    "directional": DirectionalLight((0.3, 0.2, 0.9), (0.8, 1.0, 0.6)),
    "low": DirectionalLight((1.0, 0.2, 0.15), (0.8, 1.0, 0.6)),
    "sphere": SphereLight((0.5, -0.4, 1.0), 0.3, (1.0, 2.0, 3.0)),
    "rectangle": RectangleLight(
        (-0.6, 0.4, 1.2), (0.6, -0.4, -1.2), (0.0, 1.0, 0.0), (0.5, 0.7), (2.0, 1.0, 3.0)
    ),
    "surroundings": EnvironmentLight(radiance=(0.3, 0.6, 0.9)),
}


def channels(maps: MapSet) -> list[MapSet]:
    """Three materials without a colour, each with one channel of F0."""
    return [replace(maps, specular=maps.specular[c : c + 1]) for c in range(3)]


def alone(maps: MapSet, scene: Scene, effects: str) -> np.ndarray:
    """The picture of which each channel is another material's."""
    each = [relight(one, scene, effects=effects)[..., c] for c, one in enumerate(channels(maps))]
    return np.stack(each, axis=-1)


@pytest.mark.parametrize("kind", ["plane", "sphere"])
@pytest.mark.parametrize("light", LIGHTS)
def test_every_light_and_effect_gives_each_channel_its_own(light, kind):
    maps = coloured(bumpy(relief=0.03))
    camera = Camera(position=(0.9, -0.5, 1.9), target=(0.0, 0.0, 0.0))
    scene = Scene(Film(40, 30), camera, Surface(kind, 2.0, 1.5), (LIGHTS[light],))
    found = relight(maps, scene, effects="all")
    np.testing.assert_allclose(found, alone(maps, scene, "all"), rtol=2e-6, atol=1e-7)
    grey = relight(replace(maps, specular=maps.specular.mean(0, keepdim=True)), scene)
    assert np.abs(found - grey).max() > 0.02 * found.max()


def test_a_varied_sky_is_mirrored_channel_by_channel(tmp_path, monkeypatch):
    from matcap.files.exr import write_exr

    monkeypatch.setattr("matcap.relight.environment_map._SUMMED", 32)  # as fine as the sky
    sky = np.random.default_rng(3).random((16, 32, 3)).astype(np.float32) ** 3
    sky[4, 7] = (900.0, 500.0, 300.0)  # a sun
    write_exr(tmp_path / "sky.exr", sky, half=False)
    maps = coloured(bumpy(relief=0.03))
    light = EnvironmentLight(file=tmp_path / "sky.exr")
    for kind in ("plane", "sphere"):
        scene = Scene(Film(24, 18), None, Surface(kind, 2.0), (light,))
        found = relight(maps, scene, effects="all")
        np.testing.assert_allclose(found, alone(maps, scene, "all"), rtol=2e-6, atol=1e-7)


def test_a_plan_knows_the_brightest_channel():
    maps = flat(diffuse=0.0)
    colour = torch.tensor([0.02, 0.03, 0.9])[:, None, None]
    blue = replace(maps, specular=colour * maps.height.add(1))
    assert Texture.from_maps(blue).extremes.specular == pytest.approx(0.9)
    facing = Scene(Film(8, 6), None, Surface(), (PointLight((0.0, 0.0, 2.0)),))
    steps = {step.effect: step.bound for step in Renderer(blue, facing).render().plan.steps}
    dark = Renderer(replace(maps, specular=maps.specular * 0.0 + 0.03), facing).render().plan
    least = {step.effect: step.bound for step in dark.steps}
    assert steps["specular"] > 5.0 * least["specular"]


@pytest.mark.parametrize("roughness", [0.3, 0.6, 0.9])
def test_an_even_sky_on_gold_is_what_its_lobe_reflects(roughness):
    """Single bounces by brute force, and more of them by the series they are."""
    mu, alpha = 1.0, roughness**2
    scale, bias = lobe_albedo(mu, roughness)
    once = np.array(GOLD) * scale + bias
    metal = replace(flat(4, 4, diffuse=0.0, roughness=roughness), specular=COLOUR.expand(-1, 4, 4))
    camera = Camera("orthographic", (0.0, 0.0, 3.0), (0.0, 0.0, 0.0), scale=0.5)
    scene = Scene(Film(4, 4), camera, Surface(), (EnvironmentLight(radiance=(1.0, 1.0, 1.0)),))
    single = relight(metal, scene, effects="all,-multiscatter")[1, 1]
    np.testing.assert_allclose(single, once, rtol=5e-3)
    # Each further bounce is dimmed by the mean Fresnel: a gold that is rough is more golden.
    near = albedo().near(np.full(1, alpha, np.float32))
    missing = float(albedo().missing(near, np.full(1, mu, np.float32))[0])
    mean = float(albedo().average_at(near)[0])
    fresnel = np.array(GOLD) + (1.0 - np.array(GOLD)) / 21.0
    series = sum(fresnel ** (bounce + 2) * mean * (1.0 - mean) ** bounce for bounce in range(200))
    whole = relight(metal, scene, effects="all")[1, 1]
    np.testing.assert_allclose(whole - single, series * missing, rtol=0.02, atol=2e-4)
    assert whole[2] / whole[0] < single[2] / single[0] + 1e-6
    strength, _ = multiscatter.terms(np.ones(1, np.float32), near, np.full(1, mu, np.float32))
    assert strength[0] * math.pi * (1.0 - mean) == pytest.approx(missing, rel=1e-3)


def test_neighbours_of_a_metal_send_it_no_diffuse_light():
    """One diffuse bounce is all that relief sends: a metal without albedo has none."""
    maps = replace(coloured(bumpy(relief=0.2)), diffuse=torch.zeros(3, 48, 64))
    scene = Scene(Film(24, 18), None, Surface(), (LIGHTS["low"],))
    with_it = relight(maps, scene, effects="all")
    assert np.array_equal(with_it, relight(maps, scene, effects="all,-interreflection"))
