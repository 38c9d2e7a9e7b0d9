#!/usr/bin/env bash
# colour-demosaicing's bilinear and Malvar2004 tint the border: a plain colour's corner is 2.25 times as bright.
#
# Behaviour: masked photosites are convolved with SciPy's default border, which repeats the outermost
# row. A Bayer pattern has a period of two, so that repeated photosites count twice in one colour and
# another gets none: of a plain colour (1.00, 0.50, 0.25) bilinear changes one row of pixels at each
# side, Malvar2004 two, by up to its own value. Menon2007 is right up to the border.
# Why it matters: development of RAW crop by crop, or tile by tile, leaves a coloured grid, and
# statistics of an albedo, its maximum first, come from the frame.
# Seen on 2026-12-01:
#   colour-demosaicing 0.2.7, colour-science 0.4.7
#   bilinear: corner (2.25, 0.25, 0.06), largest error 1.25, inside 0.00
#   Malvar2004: corner (1.00, 0.88, 0.75), largest error 0.53, inside 0.00
#   Menon2007: corner (1.00, 0.50, 0.25), largest error 0.00, inside 0.00
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check --no-compile colour-demosaicing==0.2.7 colour-science==0.4.7 scipy==1.17.1 numpy==2.4.6
venv/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import colour_demosaicing as demosaicing
import numpy as np

print(f"colour-demosaicing {version('colour-demosaicing')}, colour-science {version('colour-science')}")
plain = np.broadcast_to([1.0, 0.5, 0.25], (16, 16, 3))
photosites = demosaicing.mosaicing_CFA_Bayer(plain, "RGGB")
largest = []
for name in ("bilinear", "Malvar2004", "Menon2007"):
    made = getattr(demosaicing, f"demosaicing_CFA_Bayer_{name}")(photosites, "RGGB")
    error = np.abs(made - plain)
    inside = error[2:-2, 2:-2].max()
    largest.append(error.max())
    corner = ", ".join(f"{v:.2f}" for v in made[0, 0])
    print(f"{name}: corner ({corner}), largest error {largest[-1]:.2f}, inside {inside:.2f}")
    assert inside < 1e-6, "changed"
assert np.allclose(largest, [1.25, 0.53125, 0.0], atol=1e-3), "changed"
PY
