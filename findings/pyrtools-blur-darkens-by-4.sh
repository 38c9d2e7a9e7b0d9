#!/usr/bin/env bash
# pyrtools' blur and upBlur darken an image: by 4 a level, and by 2.
#
# Behaviour: blur(image, n) halves the image n times and doubles it again with a filter whose sum is 1,
# where three of four samples are 0: a plain grey of 0.5 comes out as 0.125 after one level and 0.031
# after two. upBlur divides by 2 a level in two dimensions. blurDn keeps the mean. The documentation
# states that filters are scaled to a sum of 1, and speaks of a blurred image.
# Why it matters: low frequencies that are taken with blur, for subtracting vignetting or for levels of a
# pyramid, are a quarter of what they were, and what is left holds most of the mean.
# Seen on 2026-12-01:
#   pyrtools 1.1.1
#   grey 0.5, levels 1, 2, 3: blur 0.1250, 0.0312, 0.0078; upBlur 0.2500, 0.1250, 0.0625; blurDn 0.5000, 0.5000, 0.5000
#   mean of image - blur(image), mean 0.500: 0.375
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check --no-compile pyrtools==1.1.1 numpy==2.4.6 scipy==1.17.1 matplotlib==3.11.2
venv/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np
import pyrtools as pt

grey, levels = np.full((64, 64), 0.5), (1, 2, 3)
found = {name: [float(np.median(getattr(pt, name)(grey, n))) for n in levels] for name in ("blur", "upBlur", "blurDn")}
texture = 0.5 + 0.2 * np.random.default_rng(0).standard_normal((64, 64))
texture += 0.5 - texture.mean()
left = float((texture - pt.blur(texture, 1)).mean())
print("pyrtools", version("pyrtools"))
print("grey 0.5, levels 1, 2, 3: " + "; ".join(f"{name} {', '.join(f'{v:.4f}' for v in values)}" for name, values in found.items()))
print(f"mean of image - blur(image), mean {texture.mean():.3f}: {left:.3f}")
assert np.allclose(found["blur"], [0.5 / 4**n for n in levels]) and np.allclose(found["upBlur"], [0.5 / 2**n for n in levels]), "changed"
assert np.allclose(found["blurDn"], 0.5) and abs(left - 0.375) < 0.01, "changed"
PY
