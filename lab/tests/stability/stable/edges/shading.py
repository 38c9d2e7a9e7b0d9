"""Lobes, albedo tables, compensation, and pictures under lights that have closed forms."""

import math
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from loop_calls import lobe
from numpy.typing import NDArray

from matcap.brdf.cook_torrance import cook_torrance
from matcap.files.exr import write_exr
from matcap.relight.camera import dot, view_of
from matcap.relight.effects import multiscatter
from matcap.relight.effects.multiscatter import albedo
from matcap.relight.render import Renderer
from matcap.relight.scene import (
    Camera,
    DirectionalLight,
    EnvironmentLight,
    Film,
    Light,
    PointLight,
    RectangleLight,
    Scene,
    SphereLight,
    Surface,
)
from matcap.relight.texture import Texture, alpha_of
from stable.edges.swept import Swept, compared, log_uniform
from stable.reflectance import CASES, SMOOTH

Values = NDArray[np.float64]
_LOBES = 20_000  # draws of a call
_UNSEEN = 1e-6  # 1/sr, as in the sweep of the reflectance
_RULE = 40  # points a side of the rule that albedos are integrated by
_DARK = 1e-4  # of a picture's brightest: errors of darker values are relative to it


def lobes(g: np.random.Generator, *, smooth: bool) -> Swept:
    """The reflectance of pictures, float32, against that of captures in float64.

    From roughness SMOOTH up, or below.
    """
    case = list(CASES)[int(g.integers(len(CASES)))]
    drawn = CASES[case](_LOBES, torch.Generator().manual_seed(int(g.integers(2**31))))
    given = [tensor.float() for tensor in drawn.tensors()]
    exact = cook_torrance(*(tensor.double() for tensor in given))[:, 0].numpy()
    diffuse, specular, roughness, *vectors = (tensor[:, 0].numpy() for tensor in given)
    normal, to_light, to_view = ((v[0], v[1], v[2]) for v in vectors)
    n_dot_l, n_dot_v = dot(normal, to_light), dot(normal, to_view)
    up = np.float32(0.0)
    mirror, weight = lobe(normal, to_view, to_light, alpha_of(roughness[0]))
    value = diffuse / np.float32(math.pi) + (specular + (1.0 - specular) * weight) * mirror
    value = np.where((n_dot_l > 0.0) & (n_dot_v > 0.0), value, up)
    # Which side of a horizon a direction lies on is its float32 cosine's say.
    sure = ((n_dot_l > 0.0) & (n_dot_v > 0.0)) == (exact != 0.0).any(0)
    sure &= (roughness[0] < SMOOTH) == smooth
    if not sure.any():
        return Swept()
    return compared(value[:, sure], exact[:, sure], _UNSEEN, case)


def tables(g: np.random.Generator, *, grazing: bool) -> Swept:
    """Albedo of the specular lobe, both of Schlick's parts, against an integral in float64.

    Tables are coarse where cosines are below 0.01, at grazing angles.
    """
    mu = log_uniform(g, 1e-6, 0.01, 256) if grazing else np.square(g.uniform(0.1, 1.0, 256))
    alpha = np.maximum(np.square(g.uniform(0.0, 1.0, mu.size)), 1e-6)
    total, bias = integrated(alpha, mu)
    found = albedo()
    rows = found.rows(alpha)
    parts = [
        compared(
            found.lookup(table, mu, rows), exact, 1.0,
            lambda at: f"alpha {alpha[at]:.2g}, n.v {mu[at]:.2g}",
        )
        for table, exact in ((found.fine_total, total), (found.fine_bias, bias))
    ]  # fmt: skip
    return parts[0] + parts[1]


def integrated(alpha: Values, mu: Values) -> tuple[Values, Values]:
    """Albedo with F = 1, and its part that goes with (1 - l.h)^5, by visible normals."""
    x, weights = np.polynomial.legendre.leggauss(_RULE)
    u, weights = (x + 1.0) / 2.0, weights / 2.0
    angle = 2.0 * math.pi * (np.arange(_RULE) + 0.5) / _RULE
    a, m = alpha[:, None, None], mu[:, None, None]
    sine = np.sqrt(1.0 - m * m)
    length = np.sqrt((a * sine) ** 2 + m * m)
    vx, vz = a * sine / length, m / length
    z = (1.0 - u[:, None]) * (1.0 + vz) - vz
    ring = np.sqrt(np.maximum(1.0 - z * z, 0.0))
    hx, hy, hz = a * (ring * np.cos(angle) + vx), a * ring * np.sin(angle), z + vz
    hz = np.maximum(hz, 1e-300)
    length = np.sqrt(hx * hx + hy * hy + hz * hz)
    hx, hz = hx / length, hz / length
    cosine = sine * hx + m * hz
    n_dot_l = 2.0 * cosine * hz - m
    light = np.maximum(n_dot_l, 1e-300)
    view_root = np.sqrt(a * a + (1.0 - a * a) * m * m)
    light_root = np.sqrt(a * a + (1.0 - a * a) * light * light)
    # G2 / G1 of height-correlated Smith (Heitz 2014, eq. 99).
    share = light * (m + view_root) / (light * view_root + m * light_root)
    share = np.where(n_dot_l > 0.0, share, 0.0) * weights[:, None] / _RULE
    fresnel = np.clip(1.0 - cosine, 0.0, 1.0) ** 5
    return share.sum((1, 2)), (share * fresnel).sum((1, 2))


def furnace(g: np.random.Generator) -> Swept:
    """A white metal reflects all: one bounce and what compensates for the others add up to 1."""
    alpha = g.uniform(0.0, 1.0, _LOBES).astype(np.float32)
    mu = g.uniform(0.0, 1.0, _LOBES).astype(np.float32)
    found = albedo()
    once = found.lookup(found.fine_total, mu, found.rows(alpha))
    _, more = multiscatter.terms(np.ones_like(alpha), found.near(alpha), mu)
    return compared(
        once + more, np.ones(_LOBES), 1.0, lambda at: f"alpha {alpha[at]:.2g}, n.v {mu[at]:.2g}"
    )


def flat(g: np.random.Generator, **given: float) -> Texture:
    """Four texels of one material, drawn at random but for what is given."""
    one = np.ones((1, 2, 2), np.float32)
    values = {name: given.get(name, g.uniform(0.0, 1.0)) for name in ("specular", "roughness")}
    diffuse = np.float32(given.get("diffuse", g.uniform(0.0, 1.0))) * np.repeat(one, 3, axis=0)
    return Texture(
        diffuse, one * np.float32(values["specular"]), one * np.float32(values["roughness"]),
        0.0 * one, np.zeros((2, 2, 2), np.float32), 1.0,
    )  # fmt: skip


def point_lights(g: np.random.Generator) -> Swept:
    """Point and directional lights over a plane, seen from anywhere, against float64."""
    texture, film = flat(g), Film(96, 72)
    camera = Camera(
        "perspective" if g.integers(2) else "orthographic",
        _tuple(20.0 * _upper(g)), (0.0, 0.0, 0.0), fov=8.0,
    )  # fmt: skip
    where = _upper(g) * log_uniform(g, 1e-2, 1e9)
    colour = _tuple(log_uniform(g, 1e-6, 1e6, 3))
    light: Light = PointLight(_tuple(where), colour)
    if g.integers(2):
        light = DirectionalLight(_tuple(where), colour)
    scene = Scene(film, camera, Surface(size=1e6), (light,))
    picture = Renderer(texture, scene).render(effects="none,+diffuse,+specular,+falloff").radiance
    points, to_view = _plane_points(camera, film)
    if isinstance(light, PointLight):
        away = np.asarray(light.position) - points
        squared = (away * away).sum(-1, keepdims=True)
        to_light, power = away / np.sqrt(squared), np.asarray(colour) / squared
    else:
        unit = where / np.linalg.norm(where)
        to_light, power = np.broadcast_to(unit, points.shape), np.asarray(colour)
    exact = _reflected(texture, to_light, to_view) * to_light[..., 2:] * power
    size = float(np.linalg.norm(where))
    return _picture(picture, exact, f"{type(light).__name__}, {size:.2g} away, {camera.type}")


def area_lights(g: np.random.Generator) -> Swept:
    """Rectangles and spheres over a matt plane, against Lambert's and the sphere's own form."""
    film = Film(64, 48)
    texture = flat(g, diffuse=0.5, roughness=g.choice([0.02, 0.3, 1.0]))
    height = float(log_uniform(g, 0.05, 1e4))
    centre = np.array([*g.uniform(-1.0, 1.0, 2) * max(1.0, height), height])
    half = 0.9 * height * float(log_uniform(g, 1e-4, 1.0))
    radiance = _tuple(log_uniform(g, 1e-3, 1e3, 3))
    camera = Camera("orthographic", (0.0, 0.0, 2.0), (0.0, 0.0, 0.0), scale=1.0)
    points, _ = _plane_points(camera, film)
    light: RectangleLight | SphereLight
    if g.integers(2):
        light = SphereLight(_tuple(centre), half, radiance)
        away = centre - points
        squared = (away * away).sum(-1)
        exact = math.pi * half**2 / squared * away[..., 2] / np.sqrt(squared)
    else:
        normal, up = -_upper(g), g.normal(size=3)
        sides = 2.0 * half * g.uniform(0.1, 0.7, 2)
        light = RectangleLight(
            _tuple(centre), _tuple(normal), _tuple(up), (sides[0], sides[1]), radiance
        )
        exact = _form_factor(points, centre, normal, up, sides)
    scene = Scene(film, camera, Surface(size=None, repeat=1.0), (light,))
    # The same material over more of the plane than the camera sees.
    renderer = Renderer(replace(texture, texel_size=2.0), scene)
    picture = renderer.render(effects="none,+diffuse,+falloff,+area").radiance
    expected = 0.5 / math.pi * exact[..., None] * np.asarray(radiance)
    shape = f"{type(light).__name__} of half size {half / height:.2g} of its height"
    return _picture(picture, expected, f"{shape}, roughness {texture.roughness[0, 0, 0]:.2g}")


def environments(g: np.random.Generator) -> Swept:
    """Radiance linear in direction, and one bright texel, on a matt and a mirroring sphere."""
    film = Film(96, 72)
    mirror = bool(g.integers(2))
    texture = flat(g, diffuse=0.0, roughness=0.01) if mirror else flat(g, diffuse=0.5, specular=0.0)
    mean = log_uniform(g, 1e-6, 1e6, 3)
    slope = mean[:, None] * g.uniform(0.0, 1.0) * _upper(g)
    azimuth = ((np.arange(256) + 0.5) / 256 - 0.5) * 2.0 * math.pi
    polar = (np.arange(128) + 0.5) * math.pi / 128
    ring, y = np.sin(polar)[:, None], np.cos(polar)[:, None]
    towards = np.stack(
        np.broadcast_arrays(-np.sin(azimuth) * ring, y, np.cos(azimuth) * ring), axis=-1
    )
    pixels = mean + towards @ slope.T
    hot = 0.0 if mirror or g.integers(2) else float(log_uniform(g, 1e2, 1e8))
    row, column = int(g.integers(8, 120)), int(g.integers(256))
    pixels[row, column] += hot * mean
    camera = Camera("orthographic", (0.0, 0.0, 3.0), (0.0, 0.0, 0.0), scale=0.55)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "sky.exr"
        write_exr(file, pixels.astype(np.float32), half=False)
        scene = Scene(film, camera, Surface("sphere", 1.0), (EnvironmentLight(file),))
        effects = "none,+specular,+environment" if mirror else "none,+diffuse,+environment"
        picture = Renderer(texture, scene).render(effects=effects).radiance
    normal, seen = _sphere_normals(film)
    if mirror:
        cosine = normal[..., 2:]
        mirrored = 2.0 * cosine * normal - np.array([0.0, 0.0, 1.0])
        f0 = float(texture.specular[0, 0, 0])
        exact = (f0 + (1.0 - f0) * (1.0 - cosine) ** 5) * (mean + mirrored @ slope.T)
        seen = seen & (normal[..., 2] > 0.3)  # nearer the rim a lobe is no mirror's any more
    else:
        irradiance = math.pi * mean + 2.0 * math.pi / 3.0 * (normal @ slope.T)
        edges = np.cos(np.array([row, row + 1]) * math.pi / 128)
        solid = (edges[0] - edges[1]) * 2.0 * math.pi / 256
        sun = np.maximum(normal @ towards[row, column], 0.0)[..., None]
        exact = 0.5 / math.pi * (irradiance + sun * hot * mean * solid)
    kind = "mirror" if mirror else "matt"
    where = f"{kind} sphere, a texel {hot:.2g} times the mean"
    return _picture(picture[seen], exact[seen], where, dark=1.0)


def _picture(picture: NDArray[np.float32], exact: Values, where: str, dark: float = _DARK) -> Swept:
    """A picture (..., 3) beside the exact one, channel by channel.

    Errors of values below `dark` of the brightest are relative to that.
    """
    brightest = np.abs(exact).reshape(-1, 3).max(0)
    return compared(picture, exact, np.maximum(dark * brightest, 1e-30), where)


def _upper(g: np.random.Generator) -> Values:
    """A unit vector at least 6 degrees above the plane."""
    z, around = g.uniform(0.1, 1.0), g.uniform(0.0, 2.0 * math.pi)
    ring = math.sqrt(1.0 - z * z)
    return np.array([ring * math.cos(around), ring * math.sin(around), z])


def _tuple(vector: Values) -> tuple[float, float, float]:
    x, y, z = (float(component) for component in vector)
    return x, y, z


def _plane_points(camera: Camera, film: Film) -> tuple[Values, Values]:
    """(H, W, 3) float64 points of the plane that pixels see, and directions to the camera."""
    origin, direction = view_of(camera, film, 2.0).rays(0, film.height)
    points = origin - origin[2] / direction[2] * direction
    return np.moveaxis(points, 0, -1), np.moveaxis(-direction, 0, -1)


def _reflected(texture: Texture, to_light: Values, to_view: Values) -> Values:
    """(H, W, 3) reflectance of a plane of one material, float64."""

    def tensor(value: Values) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(np.moveaxis(value, -1, 0)))

    up = np.broadcast_to(np.array([0.0, 0.0, 1.0]), to_light.shape)
    diffuse, specular, roughness = (
        torch.from_numpy(m[:, :1, :1].astype(np.float64))
        for m in (texture.diffuse, texture.specular, texture.roughness)
    )
    value = cook_torrance(
        diffuse, specular, roughness, tensor(up), tensor(to_light), tensor(to_view)
    )
    return np.moveaxis(value.numpy(), 0, -1)


def _form_factor(
    points: Values, centre: Values, normal: Values, up: Values, sides: Values
) -> Values:
    """Irradiance on the plane by a rectangle of radiance 1 (Lambert 1760: a sum over edges)."""
    along = up - normal * (up @ normal)
    along /= np.linalg.norm(along)
    across = np.cross(along, normal)
    corners = [
        centre + across * (a * sides[0]) + along * (b * sides[1]) - points
        for a, b in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
    ]
    total = np.zeros(points.shape[:-1])
    for first, second in zip(corners, [*corners[1:], corners[0]], strict=True):
        turned = np.cross(first, second)
        length = np.linalg.norm(turned, axis=-1)
        angle = np.arctan2(length, (first * second).sum(-1))
        total += angle * turned[..., 2] / np.maximum(length, 1e-300)
    before = ((points - centre) @ normal) > 0.0
    return np.where(before, np.abs(total) / 2.0, 0.0)


def _sphere_normals(film: Film) -> tuple[Values, NDArray[np.bool_]]:
    """(H, W, 3) normals of a sphere of diameter 1 seen by parallel rays, and where it is seen."""
    scale = 2.0 * 0.55 / film.width
    x = (np.arange(film.width) + 0.5 - film.width / 2) * scale / 0.5
    y = (film.height / 2 - np.arange(film.height) - 0.5) * scale / 0.5
    x, y = np.broadcast_arrays(x[None, :], y[:, None])
    squared = 1.0 - x * x - y * y
    return np.stack([x, y, np.sqrt(np.maximum(squared, 0.0))], axis=-1), squared > 1e-3
