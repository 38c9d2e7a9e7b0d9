"""The reflectance model, its parameters and coloured F0."""

import json
import math
from dataclasses import replace

import cv2
import numpy as np
import OpenEXR
import pytest
import torch
from random_maps import random_maps

from matcap.brdf.adjust import Adjustments, adjusted, adjusted_planes
from matcap.brdf.cook_torrance import (
    ALBEDO_LIMITS,
    F0_LIMITS,
    ROUGHNESS_LIMITS,
    SINGLE_ROUGHNESS,
    Angles,
    SurfaceParameters,
    cook_torrance,
    normalize,
    specular_lobe,
)
from matcap.brdf.folder import MapSetInfo, read_mapset, write_mapset
from matcap.brdf.maps import DIFFUSE, HEIGHT, ROUGHNESS, SPECULAR, MapSet, normals_from_height
from matcap.errors import MatcapError
from matcap.flash.geometry import FlashSetup, plane_points, project, unproject
from matcap.flash.light import render_flash, render_rectified

# Cook-Torrance against physics and float64; normals and the flash's geometry.

UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)[:, None, None]


def direction(theta, phi=0.0, dtype=torch.float64):
    theta, phi = torch.as_tensor(theta, dtype=dtype), torch.as_tensor(phi, dtype=dtype)
    s = torch.sin(theta)
    return torch.stack([s * torch.cos(phi), s * torch.sin(phi), torch.cos(theta)])[..., None, None]


def scalar(value, dtype=torch.float64):
    return torch.tensor(value, dtype=dtype)[None, None, None]


@pytest.mark.parametrize("roughness", [0.05, 0.3, 0.9])
def test_reflectance_is_reciprocal(roughness):
    a, b = direction(1.2, 0.3), direction(0.4, 2.0)
    args = (scalar(0.3).expand(3, 1, 1), scalar(0.04), scalar(roughness), UP)
    assert torch.allclose(cook_torrance(*args, a, b), cook_torrance(*args, b, a), rtol=1e-10)


@pytest.mark.parametrize("theta", [0.0, 0.8, 1.4])
@pytest.mark.parametrize("roughness", [0.2, 0.5, 1.0])
def test_furnace_never_gains_energy(theta, roughness):
    n = 512
    mu = (torch.arange(n, dtype=torch.float64) + 0.5) / n
    phi = (torch.arange(2 * n, dtype=torch.float64) + 0.5) / (2 * n) * 2 * math.pi
    sine = torch.sqrt(1 - mu**2)[:, None]
    light = torch.stack([sine * phi.cos(), sine * phi.sin(), mu[:, None].expand(n, 2 * n)])
    angles = Angles.exact(UP, light, direction(theta))
    lobe = specular_lobe(scalar(1.0), scalar(roughness), angles)
    assert 0.3 < float((lobe[0] * mu[:, None]).mean() * 2 * math.pi) < 1.0 + 1e-3


def test_nothing_below_the_horizon():
    args = (scalar(0.5).expand(3, 1, 1), scalar(0.5), scalar(0.5), UP)
    below, above = direction(1.8), direction(0.3)
    assert cook_torrance(*args, below, above).abs().max() == 0
    assert cook_torrance(*args, above, below).abs().max() == 0


def quick(normal, light, view):
    return Angles.quick(normal, light, view, normalize(light + view))


@pytest.mark.parametrize("roughness", [SINGLE_ROUGHNESS, 0.1, 0.3, 1.0])
@pytest.mark.parametrize("apart", [0.0, 0.01, 0.3, 1.1])
def test_the_single_precision_lobe_is_the_lobe(roughness, apart):
    gloss = scalar(0.04), scalar(roughness)
    directions = UP, direction(0.4 + apart), direction(0.4, math.pi)
    exact = specular_lobe(*gloss, Angles.exact(*directions))
    single = specular_lobe(*(g.float() for g in gloss), quick(*(d.float() for d in directions)))
    assert single.dtype == torch.float32 and torch.allclose(single.double(), exact, rtol=0.01)


def test_the_single_precision_lobe_keeps_gradients_below_the_horizon():
    roughness = scalar(0.5, torch.float32).requires_grad_()
    up = UP.float()
    angles = quick(up, direction(1.7).float(), up)
    specular_lobe(scalar(0.04).float(), roughness, angles).sum().backward()
    assert torch.isfinite(roughness.grad).all() and (roughness.grad != 0.0).all()


def test_a_zero_vector_stays_zero():
    zero = torch.zeros(3, 1, 1, requires_grad=True)
    normalize(zero).sum().backward()
    assert zero.grad.abs().max() == 0


def test_normals_of_a_tilted_plane():
    points = plane_points(0, 0, 16, 12, (16, 12), dtype=torch.float64)
    height = (0.5 * points[0] - 0.25 * points[1])[None]
    expected = normalize(torch.tensor([-0.5, 0.25, 1.0], dtype=torch.float64)[:, None, None])
    found = normals_from_height(height, 2 / 16)
    assert torch.allclose(found, expected.expand_as(found), atol=1e-12)


def test_periodic_normals_wrap():
    x = torch.arange(32, dtype=torch.float64)
    height = torch.sin(2 * math.pi * x / 32).expand(1, 8, 32)
    normal = normals_from_height(height, 1.0, periodic=True)
    assert torch.allclose(normal[:, :, 0], normal.roll(32, 2)[:, :, 0])
    slope = -normal[0, 0] / normal[2, 0]
    exact = math.sin(2 * math.pi / 32) * torch.cos(2 * math.pi * x / 32)
    assert torch.allclose(slope, exact, atol=1e-12)


def test_projection_is_undone_and_tilts_turn_as_documented():
    setup = FlashSetup(tilt=(0.1, -0.2))
    points = plane_points(0, 0, 20, 15, (20, 15), dtype=torch.float64)
    assert torch.allclose(unproject(project(points, setup), setup), points, atol=1e-12)
    top, left = torch.tensor([[0, 0.5, 0], [-0.5, 0, 0]]).double()[..., None, None]
    # Nearer to the camera means further from the picture's middle, by more than the turn shrinks.
    assert project(top, FlashSetup(tilt=(0.1, 0.0)))[1] > 0.5
    assert project(left, FlashSetup(tilt=(0.0, 0.1)))[0] < -0.5


def test_brightness_follows_distance_squared_and_intensity():
    maps = MapSet(scalar(0.4).expand(3, 1, 1), scalar(0.04), scalar(0.5), scalar(0.0), 1.0)
    point = torch.zeros(3, 1, 1, dtype=torch.float64)
    near = FlashSetup(fov=60.0)
    far = FlashSetup(fov=math.degrees(2 * math.atan(math.tan(math.radians(30)) / 2)))
    assert far.distance == pytest.approx(2 * near.distance)
    ratio = render_flash(maps, near, point) / render_flash(maps, far, point)
    assert torch.allclose(ratio, torch.full_like(ratio, 4.0))
    double = render_flash(maps, near.with_intensity((2.0, 2.0, 2.0)), point)
    assert torch.allclose(double, 2 * render_flash(maps, near, point))


# Surfaces as numbers of which any is allowed: one way in, one way out.

TEXEL = 1.0 / 64.0


def _maps(least: float = 0.05, most: float = 0.95) -> MapSet:
    draw = torch.rand(6, 8, 12, generator=torch.Generator().manual_seed(1))
    return MapSet.from_stacked(least + (most - least) * draw, TEXEL)


def test_log_parameters_and_maps_are_inverse() -> None:
    maps = _maps()
    parameters = SurfaceParameters.of(maps)
    assert torch.allclose(parameters.maps(TEXEL).stacked(), maps.stacked(), atol=1e-6)
    assert torch.equal(SurfaceParameters.from_stacked(maps.stacked()).stacked(), maps.stacked())


def test_maps_are_within_their_limits_for_any_log_parameters() -> None:
    maps = SurfaceParameters.from_stacked(200.0 * torch.randn(6, 8, 12)).maps(TEXEL)
    for values, (least, most) in ((maps.diffuse, ALBEDO_LIMITS), (maps.specular, F0_LIMITS)):
        assert float(values.min()) >= least - 1e-6 and float(values.max()) <= most + 1e-6
    assert float(maps.roughness.min()) > 0.0 and float(maps.roughness.max()) < 1.0
    # Ends of what is taken in come back as they are.
    ends = MapSet.from_stacked(torch.tensor([0.0, 1.0])[None, None].expand(6, 1, 2), TEXEL)
    back = SurfaceParameters.of(ends).maps(TEXEL)
    assert torch.allclose(back.roughness, torch.tensor([[ROUGHNESS_LIMITS]]), atol=1e-6)


def test_log_parameter_residuals_are_added() -> None:
    maps = _maps()
    uniform = SurfaceParameters.uniform((0.3, 0.2, 0.1), 0.04, 0.5)
    residuals = SurfaceParameters.of(maps) - uniform
    assert torch.allclose((uniform + residuals).maps(TEXEL).stacked(), maps.stacked(), atol=1e-6)
    assert torch.allclose(uniform.specular, torch.tensor(math.log(0.04)))
    assert float(uniform.roughness) == 0.0
    assert torch.equal(SurfaceParameters.from_vector(uniform.vector()).diffuse, uniform.diffuse)


# F0 with a colour: three channels where some of a material is metal, one everywhere else.

INFO = MapSetInfo("gold", seed=1)
LUMINANCE = torch.tensor([0.2126, 0.7152, 0.0722])


def drawn(channels: int) -> MapSet:
    return random_maps(12, 9, channels, texel_size=2 / 512, channels=channels, low=0.2, high=0.8)


@pytest.mark.parametrize("channels", [1, 3])
def test_stacking_keeps_every_map_in_its_place(channels):
    maps = drawn(channels)
    stacked = maps.stacked()
    places = {"diffuse": DIFFUSE, "specular": SPECULAR, "roughness": ROUGHNESS, "height": HEIGHT}
    assert all(torch.equal(stacked[place], getattr(maps, n)) for n, place in places.items())
    again = SurfaceParameters.from_stacked(SurfaceParameters.of(maps).stacked())
    back = again.maps(maps.texel_size)
    assert len(back.specular) == channels and torch.allclose(back.stacked(), stacked, atol=1e-5)


def test_two_channels_are_no_colour():
    with pytest.raises(ValueError, match="specular"):
        drawn(2)


def test_three_equal_channels_shine_as_one():
    grey = drawn(1)
    setup = FlashSetup(fov=45.0)
    coloured = replace(grey, specular=grey.specular.expand(3, -1, -1))
    pictures = (render_rectified(maps, setup) for maps in (grey, coloured))
    assert torch.allclose(*pictures, rtol=1e-6)


def test_each_channel_mirrors_by_itself():
    metal = drawn(3)
    setup = FlashSetup(fov=45.0)
    whole = render_rectified(metal, setup)
    for channel in range(3):
        alone = replace(metal, specular=metal.specular[channel : channel + 1])
        assert torch.allclose(render_rectified(alone, setup)[channel], whole[channel], rtol=1e-6)


@pytest.mark.parametrize("channels", [1, 3])
def test_a_folder_reads_back_as_many_channels(tmp_path, channels):
    maps = drawn(channels)
    document = json.loads(write_mapset(maps, tmp_path, INFO).read_text())
    found, _ = read_mapset(tmp_path)
    assert torch.equal(found.specular, maps.specular.half().float())
    assert torch.equal(found.diffuse, maps.diffuse.half().float())
    # Files of sets without a colour are as they were before there was any.
    assert document.get("specular_channels") == (3 if channels == 3 else None)
    assert ("Rec.709" in document["maps"]["specular"]["meaning"]) == (channels == 3)


def test_written_pictures_are_in_rgb_order(tmp_path):
    maps = drawn(3)
    write_mapset(maps, tmp_path, INFO, png=True)
    (rgb,) = OpenEXR.File(str(tmp_path / "gold_specular.exr")).channels().values()
    assert np.array_equal(rgb.pixels, maps.specular.movedim(0, -1).half().numpy())
    png = cv2.imread(str(tmp_path / "gold_specular.png"), cv2.IMREAD_UNCHANGED)[..., ::-1]
    assert np.abs(png / 65535.0 - maps.specular.movedim(0, -1).numpy()).max() < 1e-5


@pytest.mark.parametrize(
    ("channels", "stated", "said"),
    [(3, None, "3 channels instead of 1"),
     (3, 2, "neither 1 nor 3"), (3, True, "neither 1 nor 3"), (3, "3", "neither 1 nor 3")],
)  # fmt: skip
def test_stated_and_stored_channels_must_agree(tmp_path, channels, stated, said):
    file = write_mapset(drawn(channels), tmp_path, INFO)
    document = json.loads(file.read_text())
    document.pop("specular_channels", None)
    if stated is not None:
        document["specular_channels"] = stated
    file.write_text(json.dumps(document))
    with pytest.raises(MatcapError, match=said) as refused:
        read_mapset(tmp_path)
    if "instead" in said:
        # An editor may have added a colour: what it says to do mends that.
        assert f'"specular_channels": {channels}' in refused.value.remedy
        file.write_text(json.dumps(document | {"specular_channels": channels}))
        assert len(read_mapset(tmp_path)[0].specular) == channels


def test_without_saturation_a_metal_is_grey_of_its_luminance():
    maps = drawn(3)
    found = adjusted(maps, Adjustments(saturation=0.0))
    luminance = (LUMINANCE[:, None, None] * maps.specular).sum(0)
    torch.testing.assert_close(found.specular, luminance.expand(3, -1, -1))
    # A tint and a brightness are of diffuse albedo alone.
    tinted = adjusted(maps, Adjustments(tint="#ff8040", brightness=0.5))
    assert torch.equal(tinted.specular, maps.specular)


@pytest.mark.parametrize("normal", [False, True])
@pytest.mark.parametrize("channels", [1, 3])
def test_gloss_and_relief_meet_their_own_planes(channels, normal):
    maps = drawn(channels)
    count = 5 + channels
    planes = torch.cat([maps.stacked(), maps.normal]) if normal else maps.stacked()
    found = adjusted_planes(planes.numpy(), Adjustments(relief=2.0, roughness=0.1))
    stacked = found[:count]
    assert np.array_equal(stacked[HEIGHT], 2.0 * maps.height.numpy())
    np.testing.assert_allclose(stacked[ROUGHNESS], maps.roughness.numpy() + 0.1, rtol=1e-6)
    assert np.array_equal(stacked[SPECULAR], maps.specular.numpy())
    wanted = adjusted(maps, Adjustments(relief=2.0)).normal.numpy()
    if normal:
        np.testing.assert_allclose(found[count:], wanted, atol=1e-6)


def test_painted_normals_of_a_metal_are_adjusted_too():
    maps = drawn(3)
    found = adjusted(replace(maps, painted=maps.normal), Adjustments(relief=0.5))
    assert len(found.specular) == 3
    wanted = adjusted(maps, Adjustments(relief=0.5)).normal
    torch.testing.assert_close(found.painted, wanted, atol=1e-6, rtol=0.0)
