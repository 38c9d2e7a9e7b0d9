#!/usr/bin/env bash
# dask-image's filters with mode="wrap" join each border to the far side of its chunk, not of the image.
#
# Behaviour: gaussian_filter, uniform_filter, sobel, median_filter and the others filter each chunk with
# its neighbours, and pass "wrap" on to SciPy for the chunk alone: where the image ends, texels come from
# the other end of the chunk. With one chunk the result is SciPy's; so is convolve's with any chunks.
# "reflect", "nearest", "mirror" and "constant" are right. No warning is given.
# Why it matters: textures that tile are filtered with "wrap", and large ones are cut into chunks. The
# tile then has a seam that the same call with small pictures does not show, and its normals a wrong edge.
# Seen on 2026-12-01:
#   dask-image 2026.5.0, dask 2026.8.0, SciPy 1.17.1
#   wave of 64 texels that tiles, Gaussian of 2 texels, wrap: error 0.000 in one chunk, 0.721 in chunks of 32
#   sobel: error 0.000 in one chunk, 7.981 in chunks of 32; inside, beyond 8 texels of the border: 0.000
#   reflect: 0.000; convolve with wrap: 0.000
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check --no-compile dask-image==2026.5.0 dask==2026.8.0 scipy==1.17.1 numpy==2.4.6
venv/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import dask.array as da, numpy as np
from dask_image import ndfilters
from scipy import ndimage

across = np.arange(64) / 64
tile = np.tile(np.cos(2 * np.pi * across), (64, 1))  # one period, no seam


def error(name, chunk, inside=0, **options):
    """Largest difference between dask-image in chunks and SciPy on the whole."""
    blocks = da.from_array(tile, chunks=(chunk, chunk))
    found = getattr(ndfilters, name)(blocks, **options).compute()
    wrong = np.abs(found - getattr(ndimage, name)(tile, **options))
    return float(wrong[inside : 64 - inside, inside : 64 - inside].max())


gaussian = {"sigma": 2, "mode": "wrap"}
box = {"weights": np.full((9, 9), 1 / 81), "mode": "wrap"}
print(f"dask-image {version('dask-image')}, dask {version('dask')}, SciPy {version('scipy')}")
blurred = [error("gaussian_filter", chunk, **gaussian) for chunk in (64, 32)]
print("wave of 64 texels that tiles, Gaussian of 2 texels, wrap: error {:.3f} in one chunk, {:.3f} in chunks of 32".format(*blurred))
slopes = [error("sobel", chunk, mode="wrap") for chunk in (64, 32)]
inside = error("sobel", 32, 8, mode="wrap")
print("sobel: error {:.3f} in one chunk, {:.3f} in chunks of 32; inside, beyond 8 texels of the border: {:.3f}".format(*slopes, inside))
others = error("gaussian_filter", 32, sigma=2, mode="reflect"), error("convolve", 32, **box)
print("reflect: {:.3f}; convolve with wrap: {:.3f}".format(*others))
assert blurred[0] < 1e-9 and slopes[0] < 1e-9 and inside < 1e-9 and max(others) < 1e-9, "changed"
assert blurred[1] > 0.1 and slopes[1] > 1, "changed"
PY
