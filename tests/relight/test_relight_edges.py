"""Numbers at the edge of what can be: the true picture, or one sentence with culprit and remedy."""

from importlib import import_module

import numpy as np
import pytest
import torch
from other_exr import write_other_exr
from relight_samples import bumpy, flat

from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError
from matcap.files.exr import write_exr, write_exr_channels
from matcap.relight.foreign.read import read_foreign
from matcap.relight.render import Renderer, relight
from matcap.relight.scene import (
    Camera,
    DirectionalLight,
    EnvironmentLight,
    Film,
    PointLight,
    Scene,
    Surface,
)

FILM = Film(16, 12)


def sky(folder, texel=None, value=1.0, calm=1.0, name="sky.exr"):
    """Surroundings of one radiance, a little uneven, but for a texel (row, column) of 32 x 64."""
    picture = np.full((32, 64, 3), calm, dtype=np.float32)
    picture[::2] *= 1.01
    if texel is not None:
        picture[texel] = value
    write_exr(folder / name, picture, half=False)
    return EnvironmentLight(folder / name)


def under(light, maps, kind="plane", **options):
    surface = Surface(kind, None if kind == "plane" else 1.0)
    return relight(maps, Scene(FILM, None, surface, (light,)), **options)


@pytest.mark.parametrize("value", [1e7, 1e17])
@pytest.mark.parametrize("effects", ["all", "-environment"])
def test_a_plane_does_not_see_what_shines_behind_it(tmp_path, value, effects):
    behind = sky(tmp_path, (16, 0), value)  # the border of the picture is -z
    maps = bumpy(relief=0.02)
    picture = under(behind, maps, effects=effects)
    expected = under(sky(tmp_path, name="calm.exr"), maps, effects=effects)
    np.testing.assert_allclose(picture, expected, atol=2e-5)


def test_a_texel_that_no_sum_could_hold_is_named(tmp_path):
    with pytest.raises(MatcapError, match=r"sky.exr: has a value of 1e\+30, too bright .*; clip"):
        under(sky(tmp_path, (16, 0), 1e30), flat())


@pytest.mark.parametrize("kind", ["plane", "sphere"])
def test_no_surroundings_give_negative_light(tmp_path, kind):
    for texel in ((16, 0), (16, 32), (12, 47)):
        for value in (1e6, 1e17):
            picture = under(sky(tmp_path, texel, value), bumpy(relief=0.02), kind, effects="all")
            assert np.isfinite(picture).all() and picture.min() >= 0.0


@pytest.mark.parametrize(
    ("light", "named"),
    [
        (PointLight((0.1, 0.0, 0.01), (1e38,) * 3), r"light 2 \(point\): 1e\+38"),
        (DirectionalLight((0.1, 0.0, 1.0), (1.0, 1e30, 1.0)), r"light 2 \(directional\): 1e\+30"),
        (EnvironmentLight(radiance=(1e25,) * 3), r"light 2 \(environment\): 1e\+25"),
    ],
)
def test_a_light_too_bright_is_named_with_its_remedy(light, named):
    scene = Scene(FILM, None, Surface(size=None), (PointLight((0.0, 0.0, 2.0)), light))
    with pytest.raises(MatcapError, match=f"{named} is too bright for single precision; give it"):
        relight(flat(), scene)


def test_a_picture_that_overflows_names_the_brightest_light(monkeypatch):
    monkeypatch.setattr(import_module("matcap.relight.scene"), "BRIGHTEST", np.inf)
    mirror = flat(specular=1.0, roughness=0.0)
    lights = (PointLight((0.0, 0.0, 2.0)), PointLight((0.0, 0.0, 1e-6), (1e36,) * 3))
    camera = Camera("orthographic", (0.0, 0.0, 3.0), (0.0, 0.0, 0.0), scale=1e-6)
    with pytest.raises(MatcapError, match=r"light 2 \(point\): 1e\+36 is too bright"):
        relight(mirror, Scene(FILM, camera, Surface(size=None), lights), effects="all")


def test_a_light_in_the_surface_is_no_division_by_zero():
    camera = Camera("orthographic", (0.0, 0.0, 3.0), (0.0, 0.0, 0.0), scale=1.0)
    light = PointLight((0.0, 0.0, 0.0))
    picture = relight(
        flat(), Scene(Film(5, 5), camera, Surface(size=None), (light,)), effects="all"
    )
    assert np.isfinite(picture).all()


def tall(height):
    """A piece of 8 x 8 texels whose height alternates."""
    field = height * (torch.arange(64).reshape(1, 8, 8) % 2).float()
    return MapSet(*(torch.full((n, 8, 8), 0.5) for n in (3, 1, 1)), field, 2.0 / 8)


@pytest.mark.parametrize("height", [1e7, 1e17, 1e27])
def test_heights_of_no_surface_are_refused_wherever_maps_leave(tmp_path, height):
    with pytest.raises(MatcapError, match="plane units, which no surface does; make the material"):
        Renderer(tall(height), Scene(FILM, None, Surface(), (PointLight((0.0, 0.0, 2.0)),)))
    with pytest.raises(MatcapError, match=r"height: its height reaches 1e\+.* plane units"):
        write_mapset(tall(height), tmp_path, MapSetInfo("a"))
    assert not list(tmp_path.iterdir())


def test_heights_that_no_ray_gets_through_are_refused_with_a_displacement_that_does():
    scene = Scene(FILM, None, Surface(), (PointLight((1.0, 0.0, 2.0)),))
    with pytest.raises(MatcapError, match="span 1e.03 plane units.*displacement below 0.02"):
        Renderer(tall(1e3), scene)
    lower = Scene(FILM, None, Surface(displacement=0.015), scene.lights)
    assert np.isfinite(Renderer(tall(1e3), lower).render(effects="all").radiance).all()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_maps_with_values_that_are_none_are_not_called_unreadable(tmp_path, value):
    pixels = np.full((8, 8, 3), 0.5, dtype=np.float32)
    pixels[3, 4] = value
    write_other_exr(tmp_path / "rock_diff.exr", {"RGB": pixels})
    with pytest.raises(MatcapError, match=r"rock_diff.exr: has values that are not finite .*; rep"):
        read_foreign(tmp_path)


@pytest.mark.parametrize("vertices", ["v 0 0 0\nv 1 0 0\nv 2 0 0\n", "v 0 0 0\nv 0 0 0\nv 1 1 1\n"])
def test_a_mesh_of_no_area_is_refused(tmp_path, vertices):
    path = tmp_path / "lines.obj"
    path.write_text(vertices + "f 1 2 3\n")
    scene = Scene(FILM, None, Surface("mesh", 1.0, path), (PointLight((0.0, 0.0, 2.0)),))
    with pytest.raises(MatcapError, match=r"lines.obj: no triangle has an area.*; export the mesh"):
        relight(flat(), scene)


def test_a_thin_triangle_is_no_line(tmp_path):
    path = tmp_path / "thin.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 1 0.0001 0\nf 1 2 3\n")
    scene = Scene(FILM, None, Surface("mesh", 1.0, path), (PointLight((0.0, 0.0, 2.0)),))
    assert np.isfinite(relight(flat(), scene)).all()


def test_what_half_float_cannot_hold_is_said(tmp_path):
    large = np.full((4, 4), 70000.0, dtype=np.float32)
    for write in (
        lambda: write_exr(tmp_path / "a.exr", large, half=True),
        lambda: write_exr_channels(tmp_path / "a.exr", {"Y": large}),
    ):
        with pytest.raises(MatcapError, match=r"a.exr: has values too large for half .*; scale"):
            write()
    assert not list(tmp_path.iterdir())
