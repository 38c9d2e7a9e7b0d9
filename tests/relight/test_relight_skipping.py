"""Effects left out, by picture and by tile."""

import math
from dataclasses import replace

import numpy as np
import pytest
import random_scenes
import torch
from bound_scenes import share, tries
from loop_calls import unit
from random_scenes import codes, worst_difference
from reference_errors import embossed, errors, lit, surrounded
from reference_errors import reference as mitsuba
from relight_samples import bumpy, coloured, flat

import matcap
from matcap.errors import UsageError
from matcap.files.exr import write_exr
from matcap.flash.geometry import plane_points
from matcap.flash.light import shade
from matcap.relight import render
from matcap.relight.effects import DEFAULT_TOLERANCE, Bound, area
from matcap.relight.effects import relief as parallax
from matcap.relight.plan import TILE, Budget, Tally
from matcap.relight.relief import Relief
from matcap.relight.render import (
    EFFECTS,
    Effect,
    EffectChoice,
    Renderer,
    make_plan,
    parse_choice,
    radiance_tolerance,
)
from matcap.relight.scene import (
    Camera,
    DirectionalLight,
    EnvironmentLight,
    Film,
    PointLight,
    RectangleLight,
    Scene,
    Surface,
    scene_from_light,
)
from matcap.relight.scenefile import SCENES
from matcap.relight.texture import Texture

# Skipping is safe: what the plan leaves out changes no code by more than the tolerance.
#
# The full count is run by `python tests/relight/random_scenes.py 300`.


@pytest.mark.parametrize("hue", [lambda maps: maps, coloured], ids=["grey", "coloured"])
def test_random_scenes_stay_within_the_tolerance(monkeypatch, hue):
    """Bounds go by the brightest channel: they hold for those that are darker."""
    before, skipped = random_scenes.random_maps, 0
    monkeypatch.setattr(random_scenes, "random_maps", lambda rng: hue(before(rng)))
    for seed in range(1000, 1040):
        difference, off = worst_difference(seed)
        assert difference <= DEFAULT_TOLERANCE, f"seed {seed}"
        skipped += off
    assert skipped > 2 * 40


def plan_of(maps, lights, **surface):
    renderer = Renderer(maps, Scene(Film(8, 6), None, Surface(size=None, **surface), lights))
    return renderer.render().plan


def test_a_flat_surface_needs_no_relief():
    plan = plan_of(flat(), (PointLight((1.0, 1.0, 1.0)),))
    for effect in ("shadows", "parallax", "visibility", "interreflection", "area", "environment"):
        assert not plan.on(effect)
    for effect in ("diffuse", "specular", "falloff"):
        assert plan.on(effect)


def test_no_light_above_the_steepest_slope_casts_shadows():
    maps = bumpy(relief=0.02)
    steepest = Renderer(maps, scene_from_light("top")).texture.extremes.relief_slope
    for factor, on in ((1.01, False), (0.99, True)):
        light = DirectionalLight((1.0, 0.0, factor * steepest))
        assert plan_of(maps, (light,)).on("shadows") is on
    assert not plan_of(maps, (light,), displacement=0.0).on("shadows")


def test_far_lights_do_not_fall_off_and_weak_light_is_no_light():
    far = PointLight((0.0, 0.0, 1e6), (1e12, 1e12, 1e12))
    assert not plan_of(flat(roughness=0.9), (far,)).on("falloff")
    faint = PointLight((0.0, 0.0, 1.0), (1e-9, 1e-9, 1e-9))
    assert not plan_of(flat(roughness=0.9), (faint,)).running


def test_dull_material_needs_no_multiple_scattering():
    sky = (EnvironmentLight(radiance=(0.1, 0.1, 0.1)),)
    assert not plan_of(flat(specular=0.04, roughness=0.4), sky).on("multiscatter")
    assert plan_of(flat(specular=1.0, roughness=0.9), sky).on("multiscatter")


def test_effects_can_be_forced_on_and_off():
    renderer = Renderer(bumpy(), scene_from_light("left"))
    assert renderer.render(effects="all").plan.running == set(EFFECTS)
    dark = renderer.render(effects="none")
    assert not dark.plan.running and not dark.radiance.any()
    assert renderer.render(effects="none,+diffuse").plan.running == {"diffuse"}
    without = renderer.render(effects="-shadows,+area").plan
    assert not without.on("shadows") and without.on("area") and without.on("parallax")


@pytest.mark.parametrize("text", ["shadow", "+shadow", "+diffuse,all", "", "+"])
def test_unknown_effects_are_named(text):
    with pytest.raises(UsageError, match="is not an effect to switch; give all, none, or"):
        parse_choice(text)


def test_tolerance_is_in_codes_after_exposure():
    assert radiance_tolerance(0.5 / 255, Film(transfer="linear")) == pytest.approx(0.5 / 255)
    assert radiance_tolerance(0.5 / 255, Film()) == pytest.approx(0.5 / 255 / 12.92)
    assert radiance_tolerance(0.1, Film(exposure=2.0)) == pytest.approx(
        ((0.1 + 0.055) / 1.055) ** 2.4 / 4.0
    )


def test_a_looser_tolerance_never_runs_more():
    renderer = Renderer(bumpy(relief=1e-4), scene_from_light("left"))
    plans = [renderer.render(tolerance=t).plan.running for t in (0.0, 1e-3, 1e-1, 10.0)]
    assert all(loose <= tight for tight, loose in zip(plans, plans[1:], strict=False))
    assert len(plans[-1]) < len(plans[0])


def test_the_plan_says_why_and_how_long():
    rows = Renderer(bumpy(), scene_from_light("left")).render().plan.rows()
    assert [row["effect"] for row in rows] == list(EFFECTS)
    assert all(row["reason"] and np.isfinite(row["milliseconds"]) for row in rows)
    assert any(row["milliseconds"] > 0.0 for row in rows if row["on"])
    assert all(row["milliseconds"] == 0.0 for row in rows if row["effect"] == "area")


# What the scenes reach today, less a little: a bound that grows loose is found out, too. That of
# area lights is loose: its lobes are taken to change as fast as the sharpest could.
REACHED = {
    "diffuse": 0.99, "specular": 0.4, "falloff": 0.9, "area": 0.015, "environment": 0.7,
    "filtering": 0.3, "parallax": 0.5, "shadows": 0.7, "visibility": 0.5,
    "interreflection": 0.35, "multiscatter": 0.95,
}  # fmt: skip


def test_every_effect_is_covered_by_the_bound_scenes(tmp_path):
    assert list(tries(tmp_path)) == list(EFFECTS) == list(REACHED)


@pytest.mark.parametrize("effect", EFFECTS)
def test_bounds_hold_and_are_tight(effect, tmp_path):
    shares = [share(effect, one) for one in tries(tmp_path)[effect]]
    assert max(shares) <= 1.0 + 1e-5, shares
    assert max(shares) >= REACHED[effect], shares


@pytest.mark.parametrize("tolerance", [0.0, 0.3, 0.5, 0.9, 1.0, 3.2, 9.9])
def test_the_sum_of_left_out_effects_is_within_the_tolerance(tolerance, monkeypatch):
    """Each of these could be left out alone at most tolerances; all of them not."""
    bounds = {name: 0.25 + 0.05 * index for index, name in enumerate(EFFECTS)}
    made = {name: Effect(lambda _, b=bound: Bound(b, "")) for name, bound in bounds.items()}
    monkeypatch.setattr(render, "EFFECTS", made)
    steps = make_plan(None, tolerance, EffectChoice()).steps
    off = sum(step.bound for step in steps if not step.on)
    assert off <= tolerance + 1e-12
    # And nothing runs that could have been left out besides.
    assert all(off + step.bound > tolerance for step in steps if step.on)


# Effects tile by tile: bounds against what they bound, whole pictures against the plain way.
#
# `python tests/relight/random_scenes.py 300` is the full count of the latter.


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
    np.testing.assert_allclose(np.bincount(rule.cell, rule.weights), 1.0 / 16.0, rtol=1e-12)


def difference(maps, scene):
    """Codes of the plan's picture minus those of everything, in tolerances, and the plan's."""
    renderer = Renderer(maps, scene)
    planned = renderer.render()
    everything = renderer.render(effects="all").radiance
    off = codes(planned.radiance, planned.film) - codes(everything, planned.film)
    return off / DEFAULT_TOLERANCE, planned


@pytest.mark.parametrize("name", SCENES)
def test_named_scenes_by_plan_equal_those_with_all_effects(name):
    film = Film(80, 60, exposure=SCENES[name].film.exposure)
    scene = Scene(film, SCENES[name].camera, SCENES[name].surface, SCENES[name].lights)
    off, planned = difference(bumpy(128, 128, relief=0.03), scene)
    assert np.abs(off).max() <= 1.0 and all(0.0 <= step.share <= 1.0 for step in planned.plan.steps)


@pytest.mark.parametrize("seed", range(3))
def test_a_large_low_light_by_plan_equals_that_with_all_effects(seed):
    """Half a tolerance: two coarse rules for the same edge would be off by three times that."""
    maps = bumpy(64, 64, seed=seed, relief=0.05)
    maps.roughness.mul_(0.6)
    light = RectangleLight(
        (-1.6, 0.3, 0.5), (1.6, -0.3, -0.5), size=(1.2, 1.2), radiance=(4.0,) * 3
    )
    off, _ = difference(maps, Scene(Film(48, 48), None, Surface(size=None), (light,)))
    assert np.abs(off).max() <= 0.5


@pytest.mark.parametrize("kind", ["plane", "sphere"])
def test_borders_of_tiles_show_no_step(kind):
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


@pytest.mark.parametrize("width", [48, 96])
def test_a_dark_floor_gets_the_light_of_white_walls_far_away(width):
    """Bounced light is bounded by the albedo of all that a texel sees, not of texels around it."""
    maps = flat(2 * width, 2 * width, 0.9, roughness=0.8)
    across = torch.arange(2 * width)
    edge = torch.minimum(across - width // 2, 3 * width // 2 - 1 - across)  # above 0 on the floor
    maps.height[:] = maps.texel_size * (24.0 - edge.clamp(0, 24))
    maps.diffuse[..., edge > 24] = 0.05
    light = DirectionalLight((0.5, 0.0, 0.866), (4.0,) * 3)
    off, _ = difference(maps, Scene(Film(96, 96), None, Surface(size=None), (light,)))
    assert np.abs(off).max() <= 1.0


def test_a_tally_counts_tiles_at_the_border_too():
    tally = Tally((70, 33))
    assert tally.tiles == (3, 2)
    tally.ran("shadows", tally.of(32, 33, 64, 70))
    assert tally.of(32, 33, 64, 70).ravel().tolist() == [5] * 6
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


# Pictures of flat material under point lights.


def relight(source, scene, **options):
    """The plain reflectance on the undisplaced plane, which the references below know."""
    plain = "-multiscatter,-parallax,-shadows,-interreflection,-filtering"
    return matcap.relight(source, scene, effects=plain, **options)


@pytest.fixture
def maps():
    return bumpy()


def reference(maps, light) -> np.ndarray:
    """The flash renderer's picture, in float64, on the maps' own grid."""
    width, height = maps.size
    points = plane_points(0, 0, width, height, (width, height), dtype=torch.float64)
    camera = torch.tensor([0.0, 0.0, 1.0 / math.tan(math.radians(22.5))], dtype=torch.float64)
    place = torch.tensor(light.position, dtype=torch.float64)
    intensity = torch.tensor(light.intensity, dtype=torch.float64)
    picture = shade(maps.map(torch.Tensor.double), points, camera, place, intensity)
    return picture.movedim(0, -1).numpy()


@pytest.mark.parametrize("light", ["flash", "top", "left", "0.3,-0.2,0.1"])
def test_the_renderer_equals_the_flash_renderer(maps, light):
    scene = scene_from_light(light)
    found = relight(maps, scene)
    assert found.shape == (48, 64, 3) and found.dtype == np.float32
    np.testing.assert_allclose(found, reference(maps, scene.lights[0]), rtol=1e-4, atol=1e-6)


def test_the_mean_of_four_pixels_a_texel_is_one_pixel_a_texel(maps):
    """Four pixels a texel: their average is nearly the picture of one pixel a texel."""
    scene = scene_from_light("top")
    whole = relight(maps, scene)
    fine = relight(maps, replace(scene, film=Film(256, 192)))
    average = fine.reshape(48, 4, 64, 4, 3).mean(axis=(1, 3))
    assert np.abs(average - whole).mean() < 0.02 * whole.mean()


def test_a_turned_camera_sees_the_same_plane(maps):
    """The same points seen straight on and along a detour through the general camera."""
    light = PointLight((0.5, 1.0, 2.0), (5.0, 5.0, 5.0))
    film = Film(64, 48)
    straight = relight(maps, Scene(film, None, Surface(size=None), (light,)))
    # A hair off the axis, so that the way of arbitrary cameras is taken.
    near = Camera(position=(1e-5, 0.0, Camera().position[2]))
    turned = relight(maps, Scene(film, near, Surface(size=None), (light,)))
    np.testing.assert_allclose(turned[2:-2, 2:-2], straight[2:-2, 2:-2], rtol=2e-3)


@pytest.mark.parametrize(
    ("position", "along", "top"),
    [
        ((0.0, 0.0, 2.4), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
        ((0.0, -0.5, 3.0), (0.0, 0.5, -3.0), (0.0, 0.0, -1.0)),
    ],
)
def test_a_camera_that_looks_along_its_up_still_has_a_top(maps, position, along, top):
    light = (PointLight((0.5, 1.0, 2.0), (5.0, 5.0, 5.0)),)
    one, other = (
        relight(maps, Scene(Film(64, 48), Camera(position=position, up=up), Surface(), light))
        for up in (along, top)
    )
    assert one.any()
    np.testing.assert_array_equal(one, other)


def test_orthographic_camera():
    """All pixels look straight down: a flat plane under a far light is evenly lit."""
    camera = Camera("orthographic", (0.0, 0.0, 5.0), scale=1.0)
    light = PointLight((0.0, 0.0, 1000.0), (1e6, 1e6, 1e6))
    picture = relight(flat(), Scene(Film(8, 8), camera, Surface(), (light,)))
    lobe = 0.04 / (4.0 * math.pi * 0.25**2)
    np.testing.assert_allclose(picture, 0.5 / math.pi + lobe, rtol=1e-4)


def test_rays_beside_the_plane_or_from_behind_are_black():
    light = PointLight((0.0, 0.0, 2.0))
    picture = relight(flat(), Scene(Film(32, 16), None, Surface(size=1.0), (light,)))
    assert picture[:, 16].all()
    small = Camera(position=(0.0, 0.0, 10.0))
    picture = relight(flat(), Scene(Film(33, 33), small, Surface(size=1.0), (light,)))
    assert picture[16, 16].all() and not picture[0].any() and not picture[:, -1].any()
    behind = Camera(position=(0.0, 0.0, -2.0))
    assert not relight(flat(), Scene(Film(8, 8), behind, Surface(), (light,))).any()
    below = PointLight((0.0, 0.0, -2.0))
    assert not relight(bumpy(), Scene(Film(8, 8), None, Surface(), (below,))).any()


def test_light_falls_off_with_distance_squared_and_adds_up(maps):
    def picture(*lights):
        return relight(maps, Scene(Film(64, 48), None, Surface(), lights))

    far, near = (
        relight(flat(1, 1), Scene(Film(1, 1), None, Surface(), (PointLight((0.0, 0.0, z)),))).mean()
        for z in (2.0, 1.0)
    )
    assert near / far == pytest.approx(4.0, rel=1e-6)
    one, two = PointLight((1.0, 0.5, 1.0)), PointLight((-1.0, 0.5, 2.0), (1.0, 2.0, 3.0))
    np.testing.assert_allclose(picture(one, two), picture(one) + picture(two), rtol=1e-5)
    np.testing.assert_array_equal(picture(one, one), 2.0 * picture(one))


def test_a_material_is_read_at_the_size_the_surface_needs(maps):
    asked = []

    class Material:
        texel_size = 2.0 / 64

        def maps(self, width, height, *, seed, x, y):
            asked.append((width, height, seed))
            return bumpy(width, height, seed)

    picture = relight(Material(), Scene(Film(64, 48), None, Surface(size=2.0), ()), seed=5)
    assert picture.shape == (48, 64, 3) and asked == [(64, 48, 5)]


def test_matcap_relight_is_the_renderer(maps):
    rendering = Renderer(maps, scene_from_light("left")).render()
    np.testing.assert_array_equal(matcap.relight(maps, "left"), rendering.radiance)


# Pictures against Mitsuba 3's, stored in references/; made again by make_references.py.
#
# Limits: the root mean square and the largest difference, both relative to the reference's mean.
# Flat scenes are compared at 1e-3 (rms); the largest may be a few times that where a light's rim
# crosses a highlight. Failure writes the picture beside the report.


def compare(found, expected, rms, largest, folder):
    error, most = errors(found, expected)
    if error > rms or most > largest:
        write_exr(folder / "found.exr", found, half=False)
        pytest.fail(f"rms {error:.2e}, largest {most:.2e}; see {folder}/found.exr")


@pytest.mark.parametrize(
    ("name", "rms", "largest"),
    [
        ("point", 1e-5, 1e-4),
        ("directional", 1e-5, 1e-4),
        ("sphere", 1e-3, 3e-3),
        ("rectangle", 1e-3, 3e-3),
    ],
)
def test_direct_light_on_flat_maps_equals_the_closed_form(name, rms, largest, tmp_path):
    compare(lit(name), mitsuba(name), rms, largest, tmp_path)


def test_environment_light_on_flat_maps_equals_the_closed_form(tmp_path):
    # As the tolerance says, 144 directions or 2584.
    for finer, rms, largest in ((1.0, 1e-3, 4e-3), (16.0, 3e-4, 1e-3)):
        compare(surrounded(finer), mitsuba("sky"), rms, largest, tmp_path)


def test_each_effect_of_relief_brings_the_picture_nearer_the_truth():
    stages = list(embossed())
    found = [rms for rms, _ in stages]
    assert found == sorted(found, reverse=True) and found[-1] < 0.4 * found[0]
    # The bounce's light is right on average.
    truth = mitsuba("embossed_bounce").mean()
    assert stages[-1][1].mean() == pytest.approx(truth, rel=0.02)
