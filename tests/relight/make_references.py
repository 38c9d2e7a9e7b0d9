"""Render the references of tests/relight with Mitsuba 3: `python tests/relight/make_references.py`.

Needs the extra `reference`. Writes small EXR pictures into tests/relight/references; takes about
ten minutes on one core. Mitsuba provides geometry, intersections, emitters and their sampling, and
for the embossed scene the path tracer; the reflectance is written here a second time, in plain
Python, from the formula in the header of brdf/cook_torrance.py, with Mitsuba's own GGX
distribution.

Flat scenes: rays through pixel centres, direct light by Mitsuba's emitter sampling at the points
of a Hammersley set. Embossed scene: the height field as a mesh, three by three repetitions, with
smooth normals, rendered with its pixels' averages; once with direct light, once with a bounce.
"""

import math
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
mi.set_variant("scalar_rgb")

from reference_scenes import FILM, LIGHTS, LOW, SKY_SIZE, embossed_maps, flat_maps  # noqa: E402

from matcap.files.exr import write_exr  # noqa: E402
from matcap.relight.scene import Camera, DirectionalLight, PointLight, RectangleLight, SphereLight  # noqa: E402

FOLDER = Path(__file__).parent / "references"
SAMPLES = {"point": 1, "directional": 1, "sphere": 8192, "rectangle": 8192, "sky": 16384}
DISTANCE = 1.0 / math.tan(math.radians(22.5))


def reflectance(diffuse, f0, roughness, normal, wi, wo):
    """(3,) f as in the header of brdf/cook_torrance.py; 0 below either horizon."""
    nl, nv = float(normal @ wo), float(normal @ wi)
    if nl <= 0 or nv <= 0 or wo[2] <= 0 or wi[2] <= 0:
        return np.zeros(3)
    half = (wi + wo) / np.linalg.norm(wi + wo)
    alpha = roughness**2
    # Mitsuba's distribution lives in a frame whose z is the normal.
    nh = float(normal @ half)
    around = mi.Vector3f(math.sqrt(max(1 - nh * nh, 0)), 0, nh)
    d = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, False).eval(around)

    def smith(c):
        return (math.sqrt(1 + alpha**2 * (1 - c * c) / (c * c)) - 1) / 2

    g = 1 / (1 + smith(nl) + smith(nv))
    f = f0 + (1 - f0) * (1 - float(wo @ half)) ** 5
    return diffuse / math.pi + d * g * f / (4 * nl * nv)


def arrays(maps):
    return {
        name: getattr(maps, name).double().movedim(0, -1).numpy()
        for name in ("diffuse", "specular", "roughness", "height", "normal")
    }


class Matcap(mi.BSDF):
    """The reflectance, textured by the texel at a surface's uv, normals left to the mesh."""

    maps = None  # set before the scene is loaded

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
        self.m_components = [flags]
        self.m_flags = flags

    def texel(self, uv):
        height, width = self.maps["height"].shape[:2]
        return int(uv.y * height) % height, int(uv.x * width) % width

    def sample(self, ctx, si, sample1, sample2, active=True):
        out = mi.BSDFSample3f()
        out.wo = mi.warp.square_to_cosine_hemisphere(sample2)
        out.pdf = mi.warp.square_to_cosine_hemisphere_pdf(out.wo)
        out.eta = 1.0
        out.sampled_type = int(self.m_flags)
        out.sampled_component = 0
        if out.pdf <= 0:
            return out, mi.Color3f(0)
        return out, self.eval(ctx, si, out.wo) / out.pdf

    def eval(self, ctx, si, wo, active=True):
        at = self.texel(si.uv)
        maps = self.maps
        f = reflectance(
            maps["diffuse"][at],
            maps["specular"][at][0],
            maps["roughness"][at][0],
            np.array([0.0, 0.0, 1.0]),
            np.array(si.wi),
            np.array(wo),
        )
        return mi.Color3f(*(f * max(wo.z, 0.0)).tolist())

    def pdf(self, ctx, si, wo, active=True):
        return mi.warp.square_to_cosine_hemisphere_pdf(wo)

    def eval_pdf(self, ctx, si, wo, active=True):
        return self.eval(ctx, si, wo), self.pdf(ctx, si, wo)


mi.register_bsdf("matcap", lambda props: Matcap(props))


def hammersley(count):
    for i in range(count):
        bits, value, scale = i, 0.0, 0.5
        while bits:
            value += scale * (bits & 1)
            bits >>= 1
            scale /= 2
        yield mi.Point2f((i + 0.5) / count, value)


def direct(light, samples):
    """(H, W, 3) direct light on the flat maps, rays through pixel centres."""
    maps = arrays(flat_maps())
    scene = mi.load_dict({"type": "scene", "light": light})
    # On its own: lights in front of the camera do not hide it.
    ground = mi.load_dict({"type": "scene", "ground": {"type": "rectangle"}})
    points = list(hammersley(samples))
    picture = np.zeros((FILM.height, FILM.width, 3))
    for row in range(FILM.height):
        for column in range(FILM.width):
            place = [
                (column + 0.5) / FILM.width * 2 - 1,
                (FILM.height / 2 - row - 0.5) / FILM.width * 2,
                0.0,
            ]
            eye = np.array([0.0, 0.0, DISTANCE])
            towards = np.array(place) - eye
            towards /= np.linalg.norm(towards)
            si = ground.ray_intersect(mi.Ray3f(eye.tolist(), towards.tolist()))
            wi = -towards
            total, broken = np.zeros(3), 0
            for point in points:
                sample, weight = scene.sample_emitter_direction(si, point, False)
                wo = np.array(sample.d)
                if not np.isfinite(wo).all() or sample.pdf <= 0:
                    broken += 1  # Mitsuba's sphere, at the very rim of its cone
                    continue
                f = reflectance(
                    maps["diffuse"][row, column],
                    maps["specular"][row, column][0],
                    maps["roughness"][row, column][0],
                    maps["normal"][row, column],
                    wi,
                    wo,
                )
                if f.any():
                    cosine = float(maps["normal"][row, column] @ wo)
                    total += f * cosine * np.array(weight)
            picture[row, column] = total / (samples - broken)
    return picture


def sky(u, v):
    """(h, w, 3) smooth surroundings with a soft sun, at (1, w) and (h, 1) places in [0, 1]."""
    sun = np.exp(-(((u - 0.6) / 0.08) ** 2) - ((v - 0.3) / 0.15) ** 2)
    base = 0.6 + 0.4 * np.cos(2 * np.pi * u) * np.sin(np.pi * v)
    return np.stack([base + 4 * sun, base + 3 * sun, 1.5 * base + 2 * sun], -1).astype(np.float32)


def centres():
    """The surroundings as matcap reads pictures: values at pixel centres."""
    height, width = SKY_SIZE
    return sky(
        ((np.arange(width) + 0.5) / width)[None, :], ((np.arange(height) + 0.5) / height)[:, None]
    )


def corners(width=1024, height=513):
    """The same as Mitsuba reads pictures: centres of columns, but first and last row the poles."""
    return sky(
        ((np.arange(width) + 0.5) / width)[None, :], (np.arange(height) / (height - 1))[:, None]
    )


def sky_emitter(picture):
    turn = mi.ScalarTransform4f().rotate([0, 1, 0], 30.0)
    return {"type": "envmap", "bitmap": mi.Bitmap(picture), "to_world": turn}


def embossed(depth, samples):
    """(H, W, 3) path-traced picture of the embossed maps."""
    maps = arrays(embossed_maps())
    Matcap.maps = maps
    height, width = maps["height"].shape[:2]
    rows, columns = np.mgrid[-height : 2 * height, -width : 2 * width]
    texel = 2.0 / width
    x = (columns + 0.5 - width / 2) * texel
    y = (height / 2 - rows - 0.5) * texel
    z = maps["height"][rows % height, columns % width, 0]
    normals = maps["normal"][rows % height, columns % width]
    uv = np.stack([(columns + 0.5) / width, (rows + 0.5) / height], -1)
    count_y, count_x = x.shape
    index = np.arange(x.size).reshape(x.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate(
        [np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)]
    )
    props = mi.Properties()
    props["bsdf"] = mi.load_dict({"type": "matcap"})
    mesh = mi.Mesh(
        "relief", x.size, len(faces), props, has_vertex_normals=True, has_vertex_texcoords=True
    )
    params = mi.traverse(mesh)
    params["vertex_positions"] = np.stack([x, y, z], -1).astype(np.float32).ravel()
    params["vertex_normals"] = normals.astype(np.float32).ravel()
    params["vertex_texcoords"] = uv.astype(np.float32).ravel()
    params["faces"] = faces.astype(np.uint32).ravel()
    params.update()
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": depth, "rr_depth": 99},
            "sensor": mitsuba_sensor(Camera(), FILM) | {"sampler": {"type": "multijitter"}},
            "relief": mesh,
            "light": mitsuba_light(LOW),
        }
    )
    return np.array(mi.render(scene, spp=samples))


def mitsuba_sensor(camera, film):
    """Mitsuba's description of a perspective camera; pixels are averages."""
    look_at = mi.ScalarTransform4f().look_at
    return {
        "type": "perspective",
        "fov": camera.fov,
        "fov_axis": "larger",
        "to_world": look_at(list(camera.position), list(camera.target), [0, 1, 0]),
        "film": {
            "type": "hdrfilm", "width": film.width, "height": film.height,
            "rfilter": {"type": "box"}, "pixel_format": "rgb",
        },
    }  # fmt: skip


def mitsuba_light(light):
    """Mitsuba's description of a light."""

    def rgb(colour):
        return {"type": "rgb", "value": list(colour)}

    if isinstance(light, PointLight):
        position = list(light.position)
        return {"type": "point", "position": position, "intensity": rgb(light.intensity)}
    if isinstance(light, DirectionalLight):
        direction = [-c for c in light.direction]
        return {"type": "directional", "direction": direction, "irradiance": rgb(light.irradiance)}
    shining = {"type": "area", "radiance": rgb(light.radiance)}
    if isinstance(light, SphereLight):
        centre = list(light.position)
        return {"type": "sphere", "center": centre, "radius": light.radius, "emitter": shining}
    assert isinstance(light, RectangleLight)
    transform = mi.ScalarTransform4f
    target = [p + n for p, n in zip(light.position, light.normal, strict=True)]
    place = transform().look_at(list(light.position), target, list(light.up))
    return {
        "type": "rectangle",
        "to_world": place @ transform().scale([light.size[0] / 2.0, light.size[1] / 2.0, 1.0]),
        "emitter": shining,
    }


def main():
    FOLDER.mkdir(exist_ok=True)

    def save(name, picture):
        write_exr(FOLDER / f"{name}.exr", np.asarray(picture, dtype=np.float32), half=False)
        print(name, picture.shape, picture.mean(), flush=True)

    save("surroundings", centres())
    chosen = sys.argv[1:] or [*LIGHTS, "sky", "embossed"]
    for name, light in LIGHTS.items():
        if name in chosen:
            save(name, direct(mitsuba_light(light), SAMPLES[name]))
    if "sky" in chosen:
        save("sky", direct(sky_emitter(corners()), SAMPLES["sky"]))
    if "embossed" in chosen:
        save("embossed_direct", embossed(2, 1024))
        save("embossed_bounce", embossed(3, 1024))


if __name__ == "__main__":
    main()
