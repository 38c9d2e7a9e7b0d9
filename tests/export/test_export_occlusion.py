"""Ambient occlusion, cavity and bent normals against rays that are followed one by one."""

import numpy as np
import pytest

from matcap.export.occlusion import CAVITY_REACH, LARGEST, occlusion, settings

SIDE = 64
RAYS = 192


def ridges():
    """Waves along one direction, six texels high."""
    return np.tile(6.0 * np.sin(2.0 * np.pi * np.arange(SIDE) / 32.0), (SIDE, 1))


def pebbles():
    """Half balls that lie about at random."""
    generator = np.random.default_rng(3)
    y, x = np.mgrid[:SIDE, :SIDE]
    field = np.zeros((SIDE, SIDE))
    for cx, cy, radius in generator.uniform((0, 0, 4), (SIDE, SIDE, 10), (24, 3)):
        across, down = ((d + SIDE / 2) % SIDE - SIDE / 2 for d in (x - cx, y - cy))
        field = np.maximum(field, np.sqrt(np.maximum(radius**2 - across**2 - down**2, 0.0)))
    return field


def grain():
    """Noise of a few texels' size: steep, and no direction like another."""
    spectrum = np.fft.fft2(np.random.default_rng(1).standard_normal((SIDE, SIDE)))
    fy, fx = np.meshgrid(*(np.fft.fftfreq(SIDE),) * 2, indexing="ij")
    field = np.fft.ifft2(spectrum * np.exp(-2.0 * (np.pi * 2.5) ** 2 * (fx**2 + fy**2))).real
    return 2.5 * field / field.std()


RELIEFS = {"ridges": ridges, "pebbles": pebbles, "grain": grain}


def followed(field, rows, columns, reach=200.0):
    """(open, bent): rays from texels, spread as the cosine about their normals.

    They go on in small steps through the bilinear surface, endlessly repeated, until they are below
    it or above its highest point.
    """
    generator = np.random.default_rng(0)
    along_x = 0.5 * (np.roll(field, -1, 1) - np.roll(field, 1, 1))[rows, columns]
    along_y = 0.5 * (np.roll(field, 1, 0) - np.roll(field, -1, 0))[rows, columns]
    normal = np.stack([-along_x, -along_y, np.ones_like(along_x)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    tangent = np.cross(normal, [0.0, 1.0, 0.0])
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    u = (np.arange(RAYS) + 0.5) / RAYS
    turn = 2.0 * np.pi * (u[:, None] * 61.8 + generator.random(len(rows)))
    out = np.sqrt(u)[:, None, None]
    ray = out * np.cos(turn)[..., None] * tangent
    ray = ray + out * np.sin(turn)[..., None] * np.cross(normal, tangent)
    ray += np.sqrt(1.0 - u)[:, None, None] * normal
    start = field[rows, columns]
    is_open = ray[..., 2] > 0.0
    distance, going = 0.5, is_open.copy()
    while going.any() and distance < reach:
        x, y = columns + distance * ray[..., 0], rows - distance * ray[..., 1]
        z = start + distance * ray[..., 2]
        hit = going & (bilinear(field, x, y) > z)
        is_open &= ~hit
        going &= ~hit & (z < field.max())
        distance += 0.5 if distance < 20.0 else 1.0
    mean = (is_open[..., None] * ray).sum(axis=0)
    return is_open.mean(axis=0), mean / np.linalg.norm(mean, axis=-1, keepdims=True)


def bilinear(field, x, y):
    left, above = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - left, y - above
    x0, y0, x1, y1 = left % SIDE, above % SIDE, (left + 1) % SIDE, (above + 1) % SIDE
    upper = field[y0, x0] * (1.0 - fx) + field[y0, x1] * fx
    lower = field[y1, x0] * (1.0 - fx) + field[y1, x1] * fx
    return upper * (1.0 - fy) + lower * fy


@pytest.mark.parametrize("relief", RELIEFS)
def test_occlusion_equals_that_of_cast_rays(relief):
    field = RELIEFS[relief]()
    rows, columns = (axis.ravel() for axis in np.mgrid[1:SIDE:6, 1:SIDE:6])
    true, bent = followed(field, rows, columns)
    assert true.min() < 0.7  # something is hidden
    made = occlusion(field.astype(np.float32), periodic=True)
    off = np.abs(made.open[rows, columns] - true)
    assert off.mean() < 0.025  # of which the rays' own noise is 0.01
    assert abs(made.open[rows, columns].mean() - true.mean()) < 0.02
    angle = np.degrees(np.arccos(np.clip((made.bent[rows, columns] * bent).sum(-1), -1.0, 1.0)))
    assert angle.mean() < 5.0 and np.allclose(np.linalg.norm(made.bent, axis=-1), 1.0, atol=1e-5)


def traced(field, spp=512, around=2):
    """(H, W) open: Mitsuba's picture of the relief, lit by an even sky, straight from above."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    copies = 2 * around + 1
    tall, side = np.tile(field, (copies, copies)), SIDE * copies
    y, x = np.mgrid[:side, :side]
    middle = (side - 1) / 2.0
    points = np.stack([x - middle, middle - y, tall], axis=-1).reshape(-1, 3)
    first = (y[:-1, :-1] * side + x[:-1, :-1]).ravel()
    corners = (first, first + side, first + 1), (first + 1, first + side, first + side + 1)
    faces = np.concatenate([np.stack(three, axis=-1) for three in corners])
    mesh = mi.Mesh("relief", len(points), len(faces))
    values = mi.traverse(mesh)
    values["vertex_positions"] = points.astype(np.float32).ravel()
    values["faces"] = faces.astype(np.uint32).ravel()
    values.update()
    place = mi.ScalarTransform4f().look_at([0, 0, 100], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": SIDE, "height": SIDE, "rfilter": {"type": "box"}}
    scene = {
        "type": "scene",
        "mesh": mesh,
        "sky": {"type": "constant"},
        "integrator": {"type": "direct"},
        "sensor": {
            "type": "orthographic",
            "to_world": place @ mi.ScalarTransform4f().scale([SIDE / 2, SIDE / 2, 1]),
            "film": film,
        },
    }
    grey = 0.5  # Mitsuba's own, of what has no material
    return np.array(mi.render(mi.load_dict(scene), spp=spp))[..., 0] / grey


@pytest.mark.programs
@pytest.mark.parametrize("relief", RELIEFS)
def test_occlusion_equals_that_of_a_path_tracer(relief):
    pytest.importorskip("mitsuba", reason="Mitsuba is not installed")
    field = RELIEFS[relief]()
    true = traced(field)
    made = occlusion(field.astype(np.float32), periodic=True).open
    assert abs(made.mean() - true.mean()) < 0.03
    assert np.abs(made - true).mean() < 0.03  # of which the rays' own noise is 0.015


def test_flat_surfaces_have_no_occlusion():
    made = occlusion(np.full((8, 8), 3.0, np.float32), periodic=False)
    assert made.open.min() > 0.999 and made.cavity.min() > 0.999
    assert np.allclose(made.bent, [0.0, 0.0, 1.0], atol=1e-4)


def test_cavity_depends_on_near_texels_alone():
    field = np.zeros((64, 64), np.float32)
    field[:, :16] = 30.0  # a wall
    made = occlusion(field, periodic=False)
    near, far = 16 + CAVITY_REACH - 2, 16 + 2 * CAVITY_REACH
    assert made.cavity[32, near] < 0.9 and made.cavity[32, far] > 0.999 > 0.95 > made.open[32, far]
    assert made.bent[32, far, 0] > 0.2  # away from it


def test_occlusion_repeats_with_the_maps():
    field = RELIEFS["pebbles"]().astype(np.float32)
    whole = occlusion(field, periodic=True).open
    moved = occlusion(np.roll(field, (13, 40), (0, 1)), periodic=True).open
    assert np.allclose(np.roll(whole, (13, 40), (0, 1)), moved, atol=1e-5)


def test_occlusion_of_large_maps_is_computed_at_half_resolution(monkeypatch):
    monkeypatch.setattr("matcap.export.occlusion.LARGEST", SIDE * SIDE - 1)
    field = RELIEFS["ridges"]().astype(np.float32)
    coarse = occlusion(field, periodic=True)
    monkeypatch.setattr("matcap.export.occlusion.LARGEST", LARGEST)
    fine = occlusion(field, periodic=True)
    assert coarse.open.size < fine.open.size
    assert np.abs(coarse.whole("open") - fine.whole("open")).mean() < 0.03
    assert coarse.whole("bent").shape == (SIDE, SIDE, 3)
    assert settings(4096, 4096)["reach"] == 2 * settings(1024, 1024)["reach"]
