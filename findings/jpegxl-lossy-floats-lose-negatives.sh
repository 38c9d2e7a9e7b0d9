#!/usr/bin/env bash
# Lossy JPEG XL of floats keeps 4 times white and loses everything below 0.
#
# Behaviour: at distance 0.5, near what the eye tells apart, a plane of float32 from -1 to 4 comes
# back within 0.2 of itself from 0 upwards, and as about -0.004 wherever it was negative. Nothing is
# reported. Lossless keeps all.
# Why it matters: heights about a mean, slopes and tangent normals of -1 to 1 are stored as floats:
# half of each is gone, though highlights above white, which one would fear for, are kept.
# Seen on 2026-11-30:
#   imagecodecs 2026.3.6
#   of -1 to 4: distance 0.5 gives -0.004 to 4.004, -1 comes back as -0.004; lossless -1.000 to 4.000
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check imagecodecs==2026.3.6 numpy==2.4.6
venv/bin/python - <<'PY'
import imagecodecs, numpy as np

plane = np.linspace(-1, 4, 256 * 256, dtype=np.float32).reshape(256, 256)
lossy, lossless = (
    imagecodecs.jpegxl_decode(imagecodecs.jpegxl_encode(plane, **how))
    for how in ({"distance": 0.5}, {"lossless": True})
)
print("imagecodecs", imagecodecs.__version__)
print(f"of -1 to 4: distance 0.5 gives {lossy.min():.3f} to {lossy.max():.3f}, -1 comes back as "
      f"{lossy[0, 0]:.3f}; lossless {lossless.min():.3f} to {lossless.max():.3f}")
positive = plane > 0.05
assert np.abs(lossy - plane)[positive].max() < 0.2, "changed: values above 0 are off too"
assert lossy.min() > -0.05 and lossy[0, 0] > -0.05, "changed: negative values come back"
assert np.array_equal(lossless, plane), "changed: lossless is not"
PY
