"""An F0 with a colour is relit as three materials of one channel each would be, light by light."""

import math
from dataclasses import replace

import numpy as np
import pytest
import random_scenes
import torch
from relight_samples import bumpy, flat
from test_relight_physics import lobe_albedo

from matcap.brdf.maps import MapSet
from matcap.relight.effects import multiscatter
from matcap.relight.effects.bound import DEFAULT_TOLERANCE
from matcap.relight.render import Renderer, relight
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
from matcap.relight.tables import albedo
from matcap.relight.texture import Texture

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


def coloured(maps: MapSet, seed: int = 0) -> MapSet:
    """The same, its F0 of any hue, another one at every texel."""
    draws = np.random.default_rng(seed).random((3, *maps.height.shape[1:]))
    hue = torch.from_numpy(draws).to(maps.specular.dtype)
    return replace(maps, specular=maps.specular * (0.3 + 0.7 * hue))


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
    scene = Scene(Film(40, 30), camera, Surface(kind, 2.0, None, 1.5), (LIGHTS[light],))
    found = relight(maps, scene, effects="all")
    np.testing.assert_allclose(found, alone(maps, scene, "all"), rtol=2e-6, atol=1e-7)
    grey = relight(replace(maps, specular=maps.specular.mean(0, keepdim=True)), scene)
    assert np.abs(found - grey).max() > 0.02 * found.max()


def test_a_varied_sky_is_mirrored_channel_by_channel(tmp_path):
    from matcap.files.exr import write_exr

    sky = np.random.default_rng(3).random((16, 32, 3)).astype(np.float32) ** 3
    sky[4, 7] = (900.0, 500.0, 300.0)  # a sun
    write_exr(tmp_path / "sky.exr", sky, half=False)
    maps = coloured(bumpy(relief=0.03))
    light = EnvironmentLight(file=tmp_path / "sky.exr")
    for kind in ("plane", "sphere"):
        scene = Scene(Film(24, 18), None, Surface(kind, 2.0), (light,))
        found = relight(maps, scene, effects="all")
        np.testing.assert_allclose(found, alone(maps, scene, "all"), rtol=2e-6, atol=1e-7)


def test_plans_leave_out_no_more_of_any_channel_than_the_tolerance(monkeypatch):
    """The bounds go by the brightest channel: they hold for those that are darker.

    In the scenes of test_relight_skipping, with another hue at every texel.
    """
    before, skipped = random_scenes.random_maps, 0
    monkeypatch.setattr(random_scenes, "random_maps", lambda rng: coloured(before(rng)))
    for seed in range(1000, 1040):
        difference, off = random_scenes.worst_difference(seed)
        assert difference <= DEFAULT_TOLERANCE, f"seed {seed}"
        skipped += off
    assert skipped > 2 * 40


def test_a_plan_knows_the_brightest_channel():
    maps = flat(diffuse=0.0)
    blue = replace(
        maps, specular=torch.tensor([0.02, 0.03, 0.9])[:, None, None] * maps.height.add(1)
    )
    texture = Texture.from_maps(blue)
    assert texture.extremes.specular == pytest.approx(0.9)
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
