"""Effects tile by tile: bounds against what they bound, whole pictures against the plain way.

`python tests/relight/random_scenes.py 300` is the full count of the latter.
"""

import numpy as np
import pytest
from random_scenes import encoded
from relight_samples import bumpy, flat

from matcap.relight import compiled, render
from matcap.relight.budget import Budget
from matcap.relight.effects import area, environment, interreflection, parallax, shadows
from matcap.relight.effects.bound import DEFAULT_TOLERANCE
from matcap.relight.effects.visibility import HorizonTest
from matcap.relight.horizons import find_horizons
from matcap.relight.named import SCENES
from matcap.relight.relief import Relief
from matcap.relight.render import Renderer
from matcap.relight.sampling import Sampler, SurfaceSample
from matcap.relight.scene import (
    Camera,
    DirectionalLight,
    EnvironmentLight,
    Film,
    PointLight,
    RectangleLight,
    Scene,
    Surface,
)
from matcap.relight.tally import TILE, Tally
from matcap.relight.texel_horizons import COARSENESS, TexelHorizons
from matcap.relight.texture import Texture
from matcap.relight.vectors import dot, unit
from matcap.relight.visible_normals import lobe_of


@pytest.fixture(scope="module")
def relief() -> Relief:
    """Steep enough for every horizon to matter, and not square."""
    return Relief(Texture.from_maps(bumpy(48, 32, seed=4, relief=0.25)), 1.0, 1.0)


@pytest.fixture(scope="module")
def plain(relief):
    def run(work, items):
        for item in items:
            work(item)

    return find_horizons(relief, bounces=True, run=run)


@pytest.fixture(params=["compiled", "plain"])
def form(request, monkeypatch):
    """Loops compiled, where they were built, and plain."""
    if request.param == "plain":
        monkeypatch.setattr(compiled, "kernel", lambda: None)
    elif compiled.kernel() is None:
        pytest.skip("the kernel was not built")


def scattered(count, seed=0):
    """Places anywhere, beyond the material's border too."""
    generator = np.random.default_rng(seed)
    return generator.uniform(-3.0, 3.0, (2, 1, count)), generator


def test_nothing_hides_a_light_above_the_shelter(relief):
    (u, v), generator = scattered(4000)
    height = relief.at(u, v)
    shelter = relief.shelter(u, v, height)
    azimuth = generator.uniform(0.0, 2.0 * np.pi, u.shape)
    for factor in (1.0, 1.2):
        tangent = shelter * factor + 1e-6
        way = np.stack([np.cos(azimuth), np.sin(azimuth), tangent]).astype(np.float32)
        assert shadows.lit(relief, (u, v), height, unit(tuple(way)), None).all()
    low = np.stack([np.cos(azimuth), np.sin(azimuth), 0.2 * shelter]).astype(np.float32)
    assert not shadows.lit(relief, (u, v), height, unit(tuple(low)), None).all()


def test_a_wall_further_away_is_a_shelter():
    """Where the floor is flat all around, nothing but distance speaks of the wall."""
    maps = flat(128, 16)
    maps.height[:, :, 64] = 0.2
    relief = Relief(Texture.from_maps(maps), 1.0, 1.0)
    u, v = np.full((1, 1), (44.5 - 64.0) * relief.texel_size), np.zeros((1, 1))
    tangent = 0.2 / (20.0 * relief.texel_size)
    assert relief.shelter(u, v, relief.at(u, v)).item() >= tangent


def test_the_highest_texel_around_is_found_across_the_border(relief):
    field = relief.heights.reshape(32, 48)
    for reach in (1, 7, 40):
        rows, columns = np.arange(32), np.arange(48)
        expected = np.full_like(field, -np.inf)
        for down in range(-min(reach, 32), min(reach, 32) + 1):
            for across in range(-min(reach, 48), min(reach, 48) + 1):
                moved = field[(rows[:, None] + down) % 32, (columns + across) % 48]
                expected = np.maximum(expected, moved)
        np.testing.assert_array_equal(relief.peaks(reach).reshape(32, 48), expected)


@pytest.mark.parametrize("texels", [np.arange(48 * 32), np.array([1535, 0, 700, 700, 47])])
@pytest.mark.usefixtures("form")
def test_horizons_of_some_texels_are_those_of_all(relief, plain, texels):
    near = TexelHorizons(relief)
    near.see(texels)
    np.testing.assert_array_equal(near.tangents[texels], plain.tangents[texels])
    np.testing.assert_allclose(near.open[texels, :1], plain.open[texels], atol=1e-6)
    np.testing.assert_array_equal(near.steepest(texels), plain.tangents[texels].max(axis=1))
    np.testing.assert_allclose(near.fine(texels), plain.bounced[texels], atol=1e-6)


@pytest.mark.usefixtures("form")
def test_no_transfer_is_longer_than_its_bound_nor_a_coarse_sum_far_off(relief, plain):
    every = np.arange(48 * 32)
    near = TexelHorizons(relief)
    near.see(every)
    most = near.open[:, 1:] * np.array(relief.texture.brightest)
    vectors = plain.bounced.reshape(-1, 3, 3)
    assert (np.linalg.norm(vectors, axis=2) <= most + 1e-6).all()
    error = np.linalg.norm(near.coarse(every).reshape(-1, 3, 3) - vectors, axis=2)
    share = error / np.maximum(most, 1e-3)
    assert np.median(share) <= 0.5 * COARSENESS and share.max() <= 4.0 * COARSENESS


def test_a_material_read_between_listed_texels_is_read_between_all(relief, plain):
    sampler = Sampler(relief.texture, 1.0)
    (u, v), _ = scattered(50)
    found = sampler.between(lambda texels: plain.bounced[texels], (u, v))
    np.testing.assert_allclose(found, sampler.extra(plain.bounced, (u, v)), atol=1e-6)


@pytest.mark.usefixtures("form")
def test_directions_that_are_left_out_of_the_sky_are_clear(relief, plain):
    """What is hidden is the same whether all directions are looked at or the low ones alone."""
    (u, v), generator = scattered(600)
    texel = Sampler(relief.texture, 1.0).nearest((u, v))
    towards = generator.normal(size=(2, 3, *u.shape)).astype(np.float32)
    towards[:, 2] = np.abs(towards[:, 2]) + 0.3
    towards[0, :2] *= 0.2  # every pixel faces the camera
    normal, to_view = (unit(tuple(one)) for one in towards)
    alpha = generator.uniform(0.02, 1.0, u.shape).astype(np.float32)
    sample = SurfaceSample((alpha,), (alpha,), alpha, normal)
    n_dot_v = dot(normal, to_view)
    facing = n_dot_v > 0.0
    assert facing.mean() > 0.9
    lobe = lobe_of(sample, to_view, n_dot_v)
    horizon = HorizonTest(plain.tangents, texel)
    steepest = np.maximum(plain.tangents[texel].max(axis=-1), 0.0)
    highest = (steepest / np.hypot(1.0, steepest) + 1e-5).astype(np.float32)
    for whole, some in zip(
        environment.hidden(lobe, 144, horizon),
        environment.hidden(lobe, 144, horizon, highest),
        strict=True,
    ):
        assert whole.max() > 0.1
        np.testing.assert_allclose(some[facing], whole[facing], atol=2e-5)


def test_rays_do_not_depend_on_their_neighbours(relief):
    (u, v), generator = scattered(300)
    view = unit(tuple(generator.normal(size=(3, 1, 300)).astype(np.float32)))
    view = (view[0], view[1], np.abs(view[2]))
    (x, y), height = parallax.shift(relief, (u, v), view)
    for i in range(0, 300, 37):
        (one_x, one_y), one = parallax.shift(
            relief, (u[:, i : i + 1], v[:, i : i + 1]), tuple(c[:, i : i + 1] for c in view)
        )
        assert (one_x, one_y, one) == (x[0, i], y[0, i], height[0, i])


@pytest.mark.parametrize("film", [Film(exposure=1.0), Film(exposure=-1.0, transfer="linear")])
def test_a_budget_is_no_more_than_the_tolerance(film):
    budget = Budget(DEFAULT_TOLERANCE, film, frozenset({"area", "environment"}))
    known = np.geomspace(1e-7, 10.0, 3000).astype(np.float32).reshape(3, 1000)
    parts = [budget.radiance(effect, known) for effect in ("area", "environment")]
    for more in (0.0, 1e-3, 0.3):
        change = encoded(known + more + sum(parts), film) - encoded(known + more, film)
        assert change.max() <= DEFAULT_TOLERANCE * 1.002
    # And at its darkest it is all of it.
    assert change.max() <= encoded(known + sum(parts), film).max()
    spent = encoded(known[:, :1] + sum(parts)[:, :1], film) - encoded(known[:, :1], film)
    assert spent.min() >= 0.98 * DEFAULT_TOLERANCE


def test_the_parts_of_a_light_weigh_what_they_measure():
    light = RectangleLight((0.0, 0.0, 300.0), (0.0, 0.0, -1.0), size=(1.0, 1.0))
    zero = np.zeros((1, 1), dtype=np.float32)
    weights = np.zeros((4, 4))
    for node in area.nodes(light, area.rule(light, 12, parts=True), (zero, zero, zero), None):
        weights[divmod(node.cell, 4)] += float(node.received[0, 0])
    np.testing.assert_allclose(weights, weights.mean(), rtol=1e-4)


def difference(maps, scene):
    """Codes of the plan's picture minus those of everything, in tolerances, and the plan's."""
    renderer = Renderer(maps, scene)
    planned = renderer.render()
    everything = renderer.render(effects="all").radiance
    codes = encoded(planned.radiance, planned.film) - encoded(everything, planned.film)
    return codes / DEFAULT_TOLERANCE, planned


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.usefixtures("form")
def test_the_named_scenes_are_what_everything_makes_them(name):
    film = Film(80, 60, exposure=SCENES[name].film.exposure)
    scene = Scene(film, SCENES[name].camera, SCENES[name].surface, SCENES[name].lights)
    maps = bumpy(128, 128, relief=0.03)
    off, planned = difference(maps, scene)
    assert np.abs(off).max() <= 1.0
    assert all(0.0 <= step.share <= 1.0 for step in planned.plan.steps)


@pytest.mark.usefixtures("form")
@pytest.mark.parametrize("seed", range(3))
def test_a_large_light_that_sets_behind_bumps_is_what_everything_makes_it(seed):
    """Half a tolerance: two coarse rules for the same edge would be off by three times that."""
    maps = bumpy(64, 64, seed=seed, relief=0.05)
    maps.roughness.mul_(0.6)
    light = RectangleLight(
        (-1.6, 0.3, 0.5), (1.6, -0.3, -0.5), size=(1.2, 1.2), radiance=(4.0,) * 3
    )
    off, _ = difference(maps, Scene(Film(48, 48), None, Surface(size=None), (light,)))
    assert np.abs(off).max() <= 0.5


@pytest.mark.parametrize("kind", ["plane", "sphere"])
def test_no_step_along_the_borders_of_tiles(kind):
    """What is left out changes no more from tile to tile than inside of them."""
    lights = (
        RectangleLight((-1.2, 1.0, 1.4), (1.2, -1.0, -1.4), size=(0.5, 0.5), radiance=(6.0,) * 3),
        EnvironmentLight(radiance=(0.2, 0.2, 0.2)),
    )
    camera = Camera("orthographic", (0.3, -1.0, 3.0), (0.0, 0.0, 0.0), scale=0.9)
    scene = Scene(Film(160, 128), camera, Surface(kind, 2.0), lights)
    off, _ = difference(bumpy(64, 64, relief=0.03), scene)
    assert np.abs(off).max() <= 1.0
    for axis in (0, 1):
        steps = np.abs(np.diff(off, axis=axis)).mean(axis=(1 - axis, 2))
        border = np.arange(len(steps)) % TILE == TILE - 1
        assert steps[border].max() <= 1.5 * np.quantile(steps[~border], 0.9) + 1e-3


def test_shadows_run_only_in_tiles_with_relief():
    """A bump in one corner of a flat floor, under a low light."""
    maps = flat(128, 128)
    row, column = np.mgrid[:128, :128]
    bump = 0.1 * np.exp(-((row - 32) ** 2 + (column - 32) ** 2) / 30.0)
    maps.height[0] = maps.height.new_tensor(np.where(bump > 1e-4, bump, 0.0))
    scene = Scene(Film(128, 128), None, Surface(size=None), (DirectionalLight((-1.0, 0.0, 0.5)),))
    off, planned = difference(maps, scene)
    assert np.abs(off).max() <= 1.0
    ran = planned.tally.maps()["shadows"]
    assert ran[1, 1] and not ran[2:].any() and 0.0 < ran.mean() < 0.5
    assert next(s for s in planned.plan.steps if s.effect == "shadows").share == ran.mean()


def test_bounces_are_left_out_where_they_would_not_show():
    maps = bumpy(64, 64, relief=0.01)
    scene = Scene(Film(96, 96), None, Surface(size=None), (PointLight((0.0, 0.0, 2.4), (20,) * 3),))
    off, planned = difference(maps, scene)
    assert np.abs(off).max() <= 1.0
    assert interreflection.__name__.endswith("interreflection")
    shares = {step.effect: step.share for step in planned.plan.steps}
    assert shares["diffuse"] == 1.0 and shares["area"] == 0.0


def test_a_tally_counts_tiles_at_the_border_too():
    tally = Tally((70, 33))
    assert tally.tiles == (3, 2)
    tally.ran("shadows", tally.of(32, 33, 64, 70))
    assert tally.maps()["shadows"].tolist() == [[False] * 3, [False, False, True]]
    assert tally.shares() == {"shadows": pytest.approx(1 / 6)}


def test_progress_goes_up_to_the_end_and_an_interruption_ends_it(monkeypatch):
    maps, scene = bumpy(), Scene(Film(64, 200), None, Surface(), (PointLight((0.0, 0.0, 2.0)),))
    told: list[float] = []
    Renderer(maps, scene).render(progress=told.append)
    assert told == sorted(told) and told[-1] == 1.0 and len(told) > 3

    def interrupted(share):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Renderer(maps, scene).render(progress=interrupted)
    assert render.TILE == TILE
