#!/usr/bin/env bash
# SciPy's mode="wrap" has a period of N texels in filters and of N - 1 in shift, zoom and map_coordinates.
#
# Behaviour: gaussian_filter(mode="wrap") joins the last texel to the first, as textures tile. shift,
# zoom, rotate, affine_transform and map_coordinates lay the last texel onto the first: a texel is
# lost each period, and a tile that is rolled by its own size is not itself. "grid-wrap" has a
# period of N, except in zoom, which also needs grid_mode=True. The documentation of modes says so.
# Why it matters: a tile rolled by half to look at its seam gets a seam, and the pattern of a tile of
# 32 texels enlarged twice is 1.6 % too large and jumps at the border.
# Seen on 2026-12-01:
#   SciPy 1.17.1
#   tile of 64 shifted by 32: error 0.191 with wrap, 0.000 with grid-wrap
#   filtered and rolled, or rolled and filtered, with wrap: difference 0.000
#   one texel of 8, shifted by 8: sum 0.0 with wrap, 1.0 with grid-wrap
#   spacing of 32 texels enlarged twice: 1.016 with wrap, 1.016 with grid-wrap, 1.000 with grid_mode too
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check --no-compile scipy==1.17.1 numpy==2.4.6
venv/bin/python - <<'PY'
import numpy as np, scipy
from scipy import ndimage

print("SciPy", scipy.__version__)
tile = np.tile(0.5 + 0.5 * np.cos(2 * np.pi * np.arange(64) / 16), (64, 1))
rolled = np.roll(tile, 32, axis=1)
errors = {m: float(np.abs(ndimage.shift(tile, (0, 32), order=1, mode=m) - rolled).max()) for m in ("wrap", "grid-wrap")}
print("tile of 64 shifted by 32: error " + ", ".join(f"{e:.3f} with {m}" for m, e in errors.items()))
filtered = np.roll(ndimage.gaussian_filter(tile, 2, mode="wrap"), 32, axis=1)
difference = float(np.abs(filtered - ndimage.gaussian_filter(rolled, 2, mode="wrap")).max())
print(f"filtered and rolled, or rolled and filtered, with wrap: difference {difference:.3f}")
sums = {m: float(ndimage.shift(np.eye(8)[0], 8, order=1, mode=m).sum()) for m in ("wrap", "grid-wrap")}
print("one texel of 8, shifted by 8: sum " + ", ".join(f"{s:.1f} with {m}" for m, s in sums.items()))
ramp = np.arange(32.0)
spacing = [
    float(0.5 / np.diff(ndimage.zoom(ramp, 2, order=1, **how))[31])
    for how in ({"mode": "wrap"}, {"mode": "grid-wrap"}, {"mode": "grid-wrap", "grid_mode": True})
]
print("spacing of 32 texels enlarged twice: {:.3f} with wrap, {:.3f} with grid-wrap, {:.3f} with grid_mode too".format(*spacing))
assert errors["wrap"] > 0.15 and errors["grid-wrap"] < 1e-9 and difference < 1e-9, "changed"
assert sums == {"wrap": 0, "grid-wrap": 1} and np.allclose(spacing, [1.016, 1.016, 1.0], atol=1e-3), "changed"
PY
