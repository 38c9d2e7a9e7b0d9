"""Skipping is safe: what the plan leaves out changes no code by more than the tolerance.

The full count is run by `python tests/relight/random_scenes.py 300`.
"""

import numpy as np
import pytest
from bound_scenes import share, tries
from random_scenes import worst_difference
from relight_samples import bumpy, flat

from matcap.errors import UsageError
from matcap.relight import planning
from matcap.relight.effects.bound import DEFAULT_TOLERANCE, Bound
from matcap.relight.effects.entries import Effect
from matcap.relight.planning import (
    EFFECTS,
    EffectChoice,
    make_plan,
    parse_choice,
    radiance_tolerance,
)
from matcap.relight.render import Renderer
from matcap.relight.scene import (
    DirectionalLight,
    EnvironmentLight,
    Film,
    PointLight,
    Scene,
    Surface,
    scene_from_light,
)


def test_random_scenes():
    skipped = 0
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


def test_forcing_effects():
    renderer = Renderer(bumpy(), scene_from_light("left"))
    assert renderer.render(effects="all").plan.running == set(EFFECTS)
    dark = renderer.render(effects="none")
    assert not dark.plan.running
    assert not dark.radiance.any()
    only = renderer.render(effects="none,+diffuse")
    assert only.plan.running == {"diffuse"}
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
    plan = Renderer(bumpy(), scene_from_light("left")).render().plan
    rows = plan.rows()
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


def test_every_effect_is_tried(tmp_path):
    assert list(tries(tmp_path)) == list(EFFECTS) == list(REACHED)


@pytest.mark.parametrize("effect", EFFECTS)
def test_no_bound_is_wrong_and_none_is_loose(effect, tmp_path):
    shares = [share(effect, one) for one in tries(tmp_path)[effect]]
    assert max(shares) <= 1.0 + 1e-5, shares
    assert max(shares) >= REACHED[effect], shares


@pytest.mark.parametrize("tolerance", [0.0, 0.3, 0.5, 0.9, 1.0, 3.2, 9.9])
def test_what_is_left_out_adds_up_to_no_more_than_the_tolerance(tolerance, monkeypatch):
    """Each of these could be left out alone at most tolerances; all of them not."""
    bounds = {name: 0.25 + 0.05 * index for index, name in enumerate(EFFECTS)}
    made = {name: Effect(lambda _, b=bound: Bound(b, "")) for name, bound in bounds.items()}
    monkeypatch.setattr(planning, "EFFECTS", made)
    steps = make_plan(None, tolerance, EffectChoice()).steps
    off = sum(step.bound for step in steps if not step.on)
    assert off <= tolerance + 1e-12
    # And nothing runs that could have been left out besides.
    assert all(off + step.bound > tolerance for step in steps if step.on)
