#!/usr/bin/env bash
# OpenCV's cvtColor decodes the sRGB curve for Lab and Luv, and not for XYZ.
#
# Behaviour: COLOR_RGB2Lab takes floats for sRGB codes and decodes them first; COLOR_RGB2XYZ takes
# the same floats for linear light. The documented formulae begin with the same matrix for both and
# have no curve. Grey of 0.5 has L* 53.4 by Lab, and Y = 0.5, that is L* 76.1, by XYZ. COLOR_LRGB2Lab exists for
# linear input; nothing exists for XYZ of codes.
# Why it matters: albedo maps are compared in Lab (Delta E against a colour chart), and are linear.
# Passed to COLOR_RGB2Lab a linear map is decoded twice: differences in dark colours are nearly
# invisible to it, and a colour of reflectance 0.05 has L* 3.6 instead of 26.7.
# Seen on 2026-11-29:
#   OpenCV 5.0.0
#   grey of 0.5: Y 0.500, which is L* 76.1; COLOR_RGB2Lab says L* 53.4, COLOR_LRGB2Lab 76.1
#   linear grey of 0.05 through COLOR_RGB2Lab: L* 3.6 instead of 26.7
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93 numpy==2.4.6
venv/bin/python - <<'PY'
import cv2, numpy as np

def of(value, code):
    return cv2.cvtColor(np.full((1, 1, 3), value, np.float32), code)[0, 0]

def lightness(y):
    return 116 * y ** (1 / 3) - 16

y = float(of(0.5, cv2.COLOR_RGB2XYZ)[1])
coded, linear = (float(of(0.5, code)[0]) for code in (cv2.COLOR_RGB2Lab, cv2.COLOR_LRGB2Lab))
dark = float(of(0.05, cv2.COLOR_RGB2Lab)[0])
print("OpenCV", cv2.__version__)
print(f"grey of 0.5: Y {y:.3f}, which is L* {lightness(y):.1f}; "
      f"COLOR_RGB2Lab says L* {coded:.1f}, COLOR_LRGB2Lab {linear:.1f}")
print(f"linear grey of 0.05 through COLOR_RGB2Lab: L* {dark:.1f} instead of {lightness(0.05):.1f}")
assert abs(y - 0.5) < 1e-3 and abs(coded - 53.4) < 0.2 and abs(linear - 76.1) < 0.2, "changed"
PY
