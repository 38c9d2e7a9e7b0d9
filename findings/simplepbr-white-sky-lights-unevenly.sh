#!/usr/bin/env bash
# simplepbr lights what faces z 60 % more than what faces x or y, from a sky that is white everywhere.
#
# Behaviour: EnvMap.sh_coefficients, of which panda3d-simplepbr takes all diffuse light of an
# environment, projects the cube map with directions that reach the face of the cube, so up to 1.7
# long, and leaves the last coefficient without the factor pi / 4 of the cosine lobe. A cube map that
# is 1 everywhere must give pi to every normal; it gives 4.19 to z, 2.62 to x and y. With unit
# directions in the same sums, x, y and z get 3.14.
# Why it matters: it is the preview of glTF materials in Panda3D. Relief is shaded by a light that is
# not there, and an albedo compared with a photograph under a measured sky is off by a third.
# Seen on 2026-12-01:
#   panda3d-simplepbr 0.13.1, panda3d 1.10.16
#   white sky: irradiance x 2.62, y 2.62, z 4.19 (pi expected)
#   with unit directions: x 3.14, y 3.14, z 3.14
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check panda3d-simplepbr==0.13.1 panda3d==1.10.16 numpy==2.4.6
venv/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np, panda3d.core as panda
from simplepbr.envmap import EnvMap

size = 64
sky = panda.Texture("white")
sky.setup_cube_map(size, panda.Texture.T_float, panda.Texture.F_rgb32)
sky.set_ram_image(np.ones((6, size, size, 3), np.float32).tobytes())
found = np.array([tuple(value) for value in
                  EnvMap(sky, prefiltered_size=16, prefiltered_samples=1, blocking_prepare=True).sh_coefficients])


def basis(x, y, z):
    """Real spherical harmonics of the first three bands, in the library's order."""
    one = np.ones_like(x)
    return np.stack([0.282095 * one, 0.488603 * x, 0.488603 * z, 0.488603 * y, 1.092548 * x * z, 1.092548 * y * z,
                     1.092548 * y * x, 0.946176 * z * z - 0.315392 * one, 0.546274 * (x * x - y * y)])


side = (np.arange(256) + 0.5) / 128 - 1
u, v = np.meshgrid(side, side)
one, angle = np.ones_like(u), (1 + u * u + v * v) ** -1.5 / 128**2
expected = np.zeros(9)
for at in ((one, u, v), (-one, u, v), (u, one, v), (u, -one, v), (u, v, one), (u, v, -one)):
    expected += (basis(*(np.array(at) / np.sqrt(1 + u * u + v * v))) * angle).sum(axis=(1, 2))
expected *= np.pi * np.array([1, *[2 / 3] * 3, *[1 / 4] * 5])
axes = basis(*np.eye(3))
sky_light, unit = found[:, 0] @ axes, expected @ axes
print(f"panda3d-simplepbr {version('panda3d-simplepbr')}, panda3d {version('panda3d')}")
print("white sky: irradiance " + ", ".join(f"{name} {value:.2f}" for name, value in zip("xyz", sky_light))
      + " (pi expected)")
print("with unit directions: " + ", ".join(f"{name} {value:.2f}" for name, value in zip("xyz", unit)))
assert sky_light[2] > 1.4 * sky_light[0] and np.allclose(unit, np.pi, atol=0.01), "changed"
PY
