#!/usr/bin/env bash
# skylibs gives a mirror ball 1.76 times the solid angle of the sphere of directions.
#
# Behaviour: solidAngles() of the format "sphere" spans each pixel by the directions of its four
# corners. Corners outside the disc of the ball are given the direction of its centre, so that a
# pixel on the rim spans from what lies behind the ball to what lies before it. The mapping has equal
# areas, 16 / n^2 steradians a pixel; rim pixels get up to 23 times that at 64 pixels and more at
# finer ones: the sum does not converge to 4 pi. "angular" and "latlong", made the same way, do.
# Why it matters: a photographed mirror ball is the cheapest environment map to light a captured
# material with. What is summed over it (irradiance, mean radiance, harmonics) comes out too large,
# and the rim, which shows what lies behind the ball, has 43 % of the weight.
# Seen on 2026-11-30:
#   skylibs 0.7.7
#   integral of radiance 1 over 4 pi: 64 pixels sphere 1.768, angular 1.000; 512 pixels sphere 1.760, angular 1.000
#   512 pixels: sphere without its rim 0.995, largest pixel 181 times 16 / n^2
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check skylibs==0.7.7 scikit-image==0.26.0 scipy==1.17.1 numpy==2.4.6
venv/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from envmap import EnvironmentMap


def angles(size, mapping):
    return EnvironmentMap(np.ones((size, size, 3), np.float32), mapping).solidAngles()


def whole(size, mapping):
    return np.nansum(angles(size, mapping)) / (4 * np.pi)


print("skylibs", version("skylibs"))
sums = {(size, mapping): whole(size, mapping) for size in (64, 512) for mapping in ("sphere", "angular")}
print("integral of radiance 1 over 4 pi: " + "; ".join(
    f"{size} pixels sphere {sums[size, 'sphere']:.3f}, angular {sums[size, 'angular']:.3f}" for size in (64, 512)))
edges = np.abs(np.linspace(-1, 1, 513))
outer = np.maximum(edges[:-1], edges[1:]) ** 2
rim = outer[:, None] + outer[None, :] > 1
ball = angles(512, "sphere")
inner = np.nansum(ball[~rim]) / (4 * np.pi)
largest = np.nanmax(ball) / (16 / 512**2)
print(f"512 pixels: sphere without its rim {inner:.3f}, largest pixel {largest:.0f} times 16 / n^2")
assert all(abs(sums[size, "angular"] - 1) < 0.001 and sums[size, "sphere"] > 1.7 for size in (64, 512)), "changed"
assert 0.98 < inner < 1, "changed"
PY
