#!/usr/bin/env bash
# OpenCV's Telea inpainting adds up to 1.4 to what it fills, whatever the range of the image is.
#
# Behaviour: inpaint() takes floats of one channel. The term of the gradient is divided by the
# gradient's own length: a unit vector is left, whose components sum to at most 1.41 in each texel.
# In 8 bits that is one code value; in a height map of 0 to 1 the hole fills with values from -0.8
# to 1.9, and in one that is 0.001 everywhere rounding alone makes it swing between -1.4 and 1.35.
# INPAINT_NS errs by 0.01 on the same ramp, and Telea by 0.02 if the image is multiplied by 65535
# before and divided afterwards.
# Why it matters: holes of height, roughness and depth maps and of linear photographs (highlights,
# dust) are filled in floats between 0 and 1, or in metres.
# Seen on 2026-11-30:
#   OpenCV 5.0.0
#   ramp of 0.52 to 0.58 in the hole: Telea -0.84 to 1.92, of 65535 times the ramp 0.51 to 0.59, NS 0.51 to 0.59
#   0.001 everywhere: Telea -1.40 to 1.35, NS 0.001 to 0.001
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93 numpy==2.4.6
venv/bin/python - <<'PY'
import cv2, numpy as np

hole = np.zeros((64, 64), np.uint8)
hole[28:36, 28:36] = 1
ramp = np.tile(np.linspace(0.3, 0.8, 64, dtype=np.float32), (64, 1))
flat = np.full((64, 64), 0.001, np.float32)


def filled(image, method, factor=1):
    found = cv2.inpaint(image * np.float32(factor), hole, 3, method)[hole > 0] / factor
    return found.min(), found.max()


telea, scaled = filled(ramp, cv2.INPAINT_TELEA), filled(ramp, cv2.INPAINT_TELEA, 65535)
stokes = filled(ramp, cv2.INPAINT_NS)
thin, thin_stokes = filled(flat, cv2.INPAINT_TELEA), filled(flat, cv2.INPAINT_NS)
inside = ramp[hole > 0]
print("OpenCV", cv2.__version__)
print(f"ramp of {inside.min():.2f} to {inside.max():.2f} in the hole: Telea {telea[0]:.2f} to {telea[1]:.2f}, "
      f"of 65535 times the ramp {scaled[0]:.2f} to {scaled[1]:.2f}, NS {stokes[0]:.2f} to {stokes[1]:.2f}")
print(f"0.001 everywhere: Telea {thin[0]:.2f} to {thin[1]:.2f}, NS {thin_stokes[0]:.3f} to {thin_stokes[1]:.3f}")
assert telea[0] < -0.5 and telea[1] > 1.5 and thin[1] - thin[0] > 1, "changed"
assert all(0.48 < value < 0.62 for value in (*scaled, *stokes)), "changed"
PY
