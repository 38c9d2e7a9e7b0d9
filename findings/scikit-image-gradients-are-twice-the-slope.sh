#!/usr/bin/env bash
# scikit-image's sobel_v, scharr_v and prewitt_v give twice the slope, farid_v gives it once.
#
# Behaviour: their kernels are normalised, but by the sum of one side: on a ramp that rises by 1 a
# pixel sobel_v, scharr_v and prewitt_v are 2, where farid_v of the same module and numpy.gradient
# are 1. The magnitudes divide by sqrt(2): sobel is 1.41 on the ramp, farid 0.70, roberts 1.
# Why it matters: normals of a height map are (-dh/dx, -dh/dy, 1). From sobel_v and sobel_h relief of
# 27 degrees is lit as 45, and a change to farid_v halves it.
# Seen on 2026-12-01:
#   scikit-image 0.26.0
#   ramp of 1 a pixel: sobel_v 2.00, scharr_v 2.00, prewitt_v 2.00, farid_v 0.99, numpy.gradient 1.00
#   magnitude: sobel 1.41, scharr 1.41, prewitt 1.41, farid 0.70, roberts 1.00
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check scikit-image==0.26.0 scipy==1.17.1 numpy==2.4.6
venv/bin/python - <<'PY'
import numpy as np, skimage
from skimage import filters

ramp = np.tile(np.arange(32.0), (32, 1))


def middle(names):
    return {name: float(getattr(filters, name)(ramp)[16, 16]) for name in names}


slopes = middle(("sobel_v", "scharr_v", "prewitt_v", "farid_v"))
slopes["numpy.gradient"] = float(np.gradient(ramp, axis=1)[16, 16])
lengths = middle(("sobel", "scharr", "prewitt", "farid", "roberts"))
print("scikit-image", skimage.__version__)
print("ramp of 1 a pixel: " + ", ".join(f"{name} {value:.2f}" for name, value in slopes.items()))
print("magnitude: " + ", ".join(f"{name} {value:.2f}" for name, value in lengths.items()))
assert np.allclose(list(slopes.values()), [2, 2, 2, 0.99, 1], atol=0.005), "changed"
assert np.allclose(list(lengths.values()), [2**0.5] * 3 + [0.70, 1], atol=0.005), "changed"
PY
