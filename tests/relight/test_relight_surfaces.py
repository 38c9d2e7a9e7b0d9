"""Sphere, cylinder and mesh; distant planes."""

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from relight_samples import bumpy, flat

from matcap.errors import MatcapError
from matcap.relight.render import Renderer, relight
from matcap.relight.scene import Camera, DirectionalLight, Film, PointLight, Scene, Surface
from matcap.relight.surfaces.mesh import load_mesh

LAMBERT = "none,+diffuse"
AHEAD = Camera("orthographic", (0.0, 0.0, 5.0), scale=1.2)


def lambert(surface, light, camera=AHEAD, size=48, maps=None):
    scene = Scene(Film(size, size), camera, surface, (light,))
    return relight(maps or flat(diffuse=1.0), scene, effects=LAMBERT)[..., 0]


def test_a_sphere_is_shaded_by_its_normals():
    light = DirectionalLight((1.0, 2.0, 2.0), (math.pi,) * 3)
    picture = lambert(Surface("sphere", 2.0), light)
    screen = ((np.arange(48) + 0.5) / 24 - 1) * 1.2
    x, y = np.meshgrid(screen, -screen)
    inside = x * x + y * y < 1.0
    z = np.sqrt(np.maximum(1 - x * x - y * y, 0))
    expected = np.where(inside, np.maximum((x + 2 * y + 2 * z) / 3, 0), 0)
    np.testing.assert_allclose(picture, expected, atol=2e-4)


def test_a_cylinder_is_shaded_around_and_even_upwards():
    light = DirectionalLight((1.0, 0.0, 1.0), (math.pi,) * 3)
    picture = lambert(Surface("cylinder", 2.0), light)
    screen = ((np.arange(48) + 0.5) / 24 - 1) * 1.2
    inside = np.abs(screen) < 1.0
    z = np.sqrt(np.maximum(1 - screen**2, 0))
    row = np.where(inside, np.maximum((screen + z) / math.sqrt(2), 0), 0)
    np.testing.assert_allclose(picture[24], row, atol=2e-4)
    np.testing.assert_allclose(picture[inside], np.broadcast_to(row, (inside.sum(), 48)), atol=2e-4)
    assert not picture[~inside].any()


def test_the_material_keeps_its_size_on_a_sphere():
    """Stripes of a known width at the equator, counted in the picture."""
    maps = flat(32, 32)
    maps.diffuse[:, :, 16:] = 0.0  # one dark and one light stripe of one unit a repetition
    surface = Surface("sphere", 2.0, repeat=4.0)
    scene = Scene(Film(400, 3), AHEAD, surface, (DirectionalLight((0.0, 0.0, 1.0)),))
    row = relight(maps, scene, effects="none,+diffuse")[1, :, 0]
    edges = np.flatnonzero(np.diff(row > 0.02 * row.max()))
    x = ((edges + 1) / 200 - 1) * 1.2
    longitude = np.arcsin(np.clip(x[np.abs(x) < 0.9], -1, 1))
    np.testing.assert_allclose(np.diff(longitude), 0.25, atol=0.03)


QUAD = """
# a square of four, its texture coordinates filling the unit square
v -1 -1 0
v 1 -1 0
v 1 1 0
v -1 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vn 0 0 1
f 1/1/1 2/2/1 3/3/1 4/4/1
"""


def test_a_square_mesh_is_the_plane(tmp_path):
    """The same material on the plane and on a mesh of two triangles, through the same camera."""
    (tmp_path / "quad.obj").write_text(QUAD)
    maps = bumpy(32, 32, relief=0.05)
    camera = Camera(position=(0.3, -1.5, 2.5))
    light = PointLight((0.5, 0.5, 1.5), (5.0, 5.0, 5.0))
    effects = "none,+diffuse,+specular,+falloff,+multiscatter"
    plane = relight(maps, Scene(Film(40, 30), camera, Surface(), (light,)), effects=effects)
    # A mesh's texture begins at its corner, a plane's in its middle: half a repetition apart.
    moved = maps.map(lambda m: m.roll((16, 16), (-2, -1)))
    scene = Scene(Film(40, 30), camera, Surface("mesh", 2.0, tmp_path / "quad.obj"), (light,))
    mesh = relight(moved, scene, effects=effects)
    both = plane.any(axis=-1) & mesh.any(axis=-1)
    assert both.sum() > 0.97 * plane.any(axis=-1).sum()
    np.testing.assert_allclose(mesh[both], plane[both], rtol=2e-3, atol=1e-5)


def uv_sphere(rows=24, columns=48):
    """An OBJ of a sphere without normals or texture coordinates, wound outwards."""
    lines = []
    for i in range(rows + 1):
        for j in range(columns):
            polar, turn = math.pi * i / rows, 2 * math.pi * j / columns
            ring = math.sin(polar)
            lines.append(f"v {ring * math.sin(turn)} {math.cos(polar)} {ring * math.cos(turn)}")
    for i in range(rows):
        for j in range(columns):
            a, b = i * columns + j, i * columns + (j + 1) % columns
            c, d = a + columns, b + columns
            lines += [f"f {a + 1} {c + 1} {b + 1}", f"f {b + 1} {c + 1} {d + 1}"]
    return "\n".join(lines)


def test_a_sphere_of_triangles_is_a_sphere(tmp_path):
    (tmp_path / "sphere.obj").write_text(uv_sphere())
    light = DirectionalLight((1.0, 2.0, 2.0), (math.pi,) * 3)
    for camera in (AHEAD, Camera(position=(0.5, 1.0, 4.0))):
        smooth = lambert(Surface("sphere", 2.0), light, camera)
        mesh = lambert(Surface("mesh", 2.0, tmp_path / "sphere.obj"), light, camera)
        both = (smooth > 0) & (mesh > 0)
        assert both.sum() > 0.95 * (smooth > 0).sum()
        assert np.abs(mesh - smooth)[both].max() < 0.05


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "there are no faces"),
        ("v 0 0 0\nv 1 0 0\nf 1 2 3\n", "line 3 is no valid 'f'"),
        ("v 0 0\n", "line 1 is no valid 'v'"),
        ("v 0 0 x\n", "line 1 is no valid 'v'"),
        ("v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n", "all vertices are in one place"),
        ("v nan 0 0\nv 0 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
    ],
)
def test_broken_meshes(tmp_path, text, message):
    (tmp_path / "a.obj").write_text(text)
    with pytest.raises(MatcapError, match=message):
        load_mesh(tmp_path / "a.obj", 2.0)


FACE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


@pytest.mark.parametrize(
    ("held", "corners", "what"),
    [
        ("", "1/1/1 2/2/1 3/3/1 4/4/1", "6 corners name normals"),
        ("vn 0 0 1\n", "1//1 2//7 3//1 4//1", "1 corners name normals"),
        ("vn 0 0 1\n", "1//1 2//0 3//1 4//-9", "2 corners name normals"),
        ("vn 0 0 1\n", f"1//1 2//1 3//1 4//{10**20}", "1 corners name normals"),
        ("vn 0 0 1\nvn 0 0 0\nvn nan 0 1\n", "1//1 2//2 3//3 4//1", ""),
    ],
)
def test_a_mesh_without_the_normals_that_it_names_has_averages(tmp_path, held, corners, what):
    (tmp_path / "a.obj").write_text(f"{FACE}{held}f {corners}\n")
    with warnings.catch_warnings(record=True) as result:
        warnings.simplefilter("always")
        mesh = load_mesh(tmp_path / "a.obj", 2.0)
    np.testing.assert_allclose(mesh.normals, np.broadcast_to([0.0, 0.0, 1.0], (2, 3, 3)))
    assert bool(result) == bool(what)
    assert what in " ".join(str(one.message) for one in result)


def test_normals_that_are_there_are_kept_beside_averages(tmp_path):
    (tmp_path / "a.obj").write_text(f"{FACE}vn 1 0 1\nf 1//1 2//1 3//1\nf 1 3 4\n")
    mesh = load_mesh(tmp_path / "a.obj", 2.0)
    np.testing.assert_allclose(mesh.normals[0], np.broadcast_to([0.5**0.5, 0.0, 0.5**0.5], (3, 3)))
    np.testing.assert_allclose(mesh.normals[1], np.broadcast_to([0.0, 0.0, 1.0], (3, 3)))


def test_a_missing_mesh(tmp_path):
    with pytest.raises(MatcapError, match="no such file"):
        load_mesh(tmp_path / "a.obj", 2.0)


def test_far_bumps_become_roughness_instead_of_sparkle():
    """A pixel over 8 x 8 texels of a bumpy mirror: filtered it shows what they show on average."""
    maps = bumpy(256, 256, seed=2, relief=0.0)
    generator = np.random.default_rng(0)
    maps.height[:] = maps.height.new_tensor(generator.normal(0.0, 0.0008, (1, 256, 256)))
    grey = 0.0 * maps.roughness
    maps = replace(maps, diffuse=maps.diffuse * 0, specular=grey + 0.5, roughness=grey + 0.25)
    light = DirectionalLight((0.2, 0.1, 1.0), (1.0, 1.0, 1.0))

    def picture(size, effects):
        scene = Scene(Film(size, size), AHEAD, Surface(displacement=0.0), (light,))
        return relight(maps, scene, effects=effects)[..., 0]

    truth = picture(512, "none,+specular").reshape(32, 16, 32, 16).mean(axis=(1, 3))
    raw = picture(32, "none,+specular")
    filtered = picture(32, "none,+specular,+filtering")
    inside = truth > 0

    def error(found):
        return np.sqrt(((found - truth)[inside] ** 2).mean()) / truth[inside].mean()

    assert error(filtered) < 0.25
    assert error(filtered) < 0.25 * error(raw)


def test_filtering_does_nothing_near_by():
    maps = bumpy(32, 24)
    scene = Scene(Film(128, 96), None, Surface(), (PointLight((0.0, 1.0, 2.0)),))
    renderer = Renderer(maps, scene)
    with_it = renderer.render(effects="all").radiance
    without = renderer.render(effects="all,-filtering").radiance
    np.testing.assert_allclose(with_it, without, rtol=1e-4)
