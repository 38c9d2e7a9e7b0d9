#!/usr/bin/env bash
# scikit-image's co-occurrence matrix at 45 degrees is Haralick's at 135 degrees.
#
# Behaviour: graycomatrix() takes the neighbour at (row + sin(angle), column + cos(angle)). Rows run
# downwards, so pi/4 is the neighbour below right; Haralick's 45 degrees, and that of most other
# programs, is the one above right. Lines that rise to the right have contrast 0.5 at pi/4 and 0 at
# 3 pi/4.
# Why it matters: directional texture statistics (twill, brushed metal, wood) of one program do not
# agree with those of another, and a synthesised texture that is mirrored can have the "right"
# statistics. Sums over the four angles hide it.
# Seen on 2026-11-29:
#   scikit-image 0.26.0
#   lines that rise to the right: contrast 0.500 at 45 degrees, 0.000 at 135 degrees
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check scikit-image==0.26.0 numpy==2.4.6
venv/bin/python - <<'PY'
import numpy as np, skimage
from skimage.feature import graycomatrix, graycoprops

row, column = np.mgrid[0:64, 0:64]
twill = ((row + column) // 4 % 2).astype(np.uint8)  # equal along row + column: rising to the right
assert (twill[1:, :-1] == twill[:-1, 1:]).all()  # each pixel equals the one above right

def contrast(angle):
    return float(graycoprops(graycomatrix(twill, [1], [angle], levels=2), "contrast")[0, 0])

rising, falling = contrast(np.pi / 4), contrast(3 * np.pi / 4)
print("scikit-image", skimage.__version__)
print(f"lines that rise to the right: contrast {rising:.3f} at 45 degrees, {falling:.3f} at 135 degrees")
assert rising > 0.4 and falling == 0.0, "the behaviour has changed"
PY
