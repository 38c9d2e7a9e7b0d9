"""Effects tile by tile: bounds against what they bound, whole pictures against the plain way.

`python tests/relight/random_scenes.py 300` is the full count of the latter.
"""

import numpy as np
import pytest
from loop_calls import unit
from random_scenes import codes
from relight_samples import bumpy

from matcap.relight import render
from matcap.relight.effects import area, parallax
from matcap.relight.effects.bound import DEFAULT_TOLERANCE
from matcap.relight.named import SCENES
from matcap.relight.plan import Budget
from matcap.relight.relief import Relief
from matcap.relight.render import Renderer
from matcap.relight.scene import (
    Camera,
    EnvironmentLight,
    Film,
    PointLight,
    RectangleLight,
    Scene,
    Surface,
)
from matcap.relight.tally import TILE, Tally
from matcap.relight.texture import Texture


@pytest.fixture(scope="module")
def relief() -> Relief:
    """Steep, and not square."""
    return Relief(Texture.from_maps(bumpy(48, 32, seed=4, relief=0.25)), 1.0, 1.0)


def scattered(count, seed=0):
    """Places anywhere, beyond the material's border too."""
    generator = np.random.default_rng(seed)
    return generator.uniform(-3.0, 3.0, (2, 1, count)), generator


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
        change = codes(known + more + sum(parts), film) - codes(known + more, film)
        assert change.max() <= DEFAULT_TOLERANCE * 1.002
    # And at its darkest it is all of it.
    assert change.max() <= codes(known + sum(parts), film).max()
    spent = codes(known[:, :1] + sum(parts)[:, :1], film) - codes(known[:, :1], film)
    assert spent.min() >= 0.98 * DEFAULT_TOLERANCE


def test_the_parts_of_a_light_weigh_what_they_measure():
    light = RectangleLight((0.0, 0.0, 300.0), (0.0, 0.0, -1.0), size=(1.0, 1.0))
    rule = area.rule(light, 12, parts=True)
    weights = np.bincount(rule.cell, rule.weights)
    np.testing.assert_allclose(weights, 1.0 / 16.0, rtol=1e-12)


def difference(maps, scene):
    """Codes of the plan's picture minus those of everything, in tolerances, and the plan's."""
    renderer = Renderer(maps, scene)
    planned = renderer.render()
    everything = renderer.render(effects="all").radiance
    off = codes(planned.radiance, planned.film) - codes(everything, planned.film)
    return off / DEFAULT_TOLERANCE, planned


@pytest.mark.parametrize("name", SCENES)
def test_the_named_scenes_are_what_everything_makes_them(name):
    film = Film(80, 60, exposure=SCENES[name].film.exposure)
    scene = Scene(film, SCENES[name].camera, SCENES[name].surface, SCENES[name].lights)
    maps = bumpy(128, 128, relief=0.03)
    off, planned = difference(maps, scene)
    assert np.abs(off).max() <= 1.0
    assert all(0.0 <= step.share <= 1.0 for step in planned.plan.steps)


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


def test_bounces_are_left_out_where_they_would_not_show():
    maps = bumpy(64, 64, relief=0.01)
    scene = Scene(Film(96, 96), None, Surface(size=None), (PointLight((0.0, 0.0, 2.4), (20,) * 3),))
    off, planned = difference(maps, scene)
    assert np.abs(off).max() <= 1.0
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
    lines: list[float] = []
    Renderer(maps, scene).render(progress=lines.append)
    assert lines == sorted(lines) and lines[-1] == 1.0 and len(lines) > 3

    def interrupted(share):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Renderer(maps, scene).render(progress=interrupted)
    assert render.TILE == TILE
