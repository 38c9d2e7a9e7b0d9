#!/usr/bin/env bash
# depth2normal takes the bits of a height map from its largest code: shallow relief in 16 bits becomes steep.
#
# Behaviour: with the default range "auto", a 16-bit map whose largest code is 255 or less is read as one of
# 8 bits, so its slopes count 257 times; with one texel at 256 they count once. A float map is read as 0 to 1
# up to 1.0, as 8 bits beyond. Slopes lean by image rows: green is DirectX's (-Y), as nothing states, and a
# flat surface is code 127, not 128, as values are cut off instead of rounded.
# Why it matters: frames of one sequence, or tiles of one map, change their relief by 257 from one to the next.
# Seen on 2026-12-01:
#   depth2normal 2.0.1
#   16 bits, slope of 1 code a texel: largest code 255: 45.3 degrees; 256: 0.2 degrees
#   float, slope of 1/64 a texel: largest value 1.0: 76.2 degrees; 1.02: 1.1 degrees
#   height rising upwards: green 217; flat: (127, 127, 255)
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check --no-compile depth2normal==2.0.1 pillow==13.0.0 numpy==2.4.6
venv/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np
from depth2normal import depth_to_normal, load_depth
from PIL import Image


def tilt(heights):
    """Angle of the normal in the middle, degrees."""
    normal = depth_to_normal(heights)[32, 32] / 255.0 * 2 - 1
    return float(np.degrees(np.arctan2(abs(normal[0]), normal[2])))


def sixteen(largest):
    """A map of 16 bits: 64 columns of slope 1 and one texel of the largest code."""
    codes = np.repeat(np.arange(64, dtype=np.uint16)[None] + 100, 64, axis=0)
    codes[0, 0] = largest
    Image.fromarray(codes).save("height.png")
    return load_depth("height.png")


slope = np.repeat(np.arange(64)[None] / 64, 64, axis=0)
brighter = slope.copy()
slope[0, 0], brighter[0, 0] = 1.0, 1.02
tilts = tilt(sixteen(255)), tilt(sixteen(256)), tilt(slope), tilt(brighter)
upwards = depth_to_normal(np.repeat(np.arange(64, 0, -1.0)[:, None] + 100, 64, axis=1))[32, 32]
flat = tuple(int(code) for code in depth_to_normal(np.full((64, 64), 100.0))[32, 32])

print("depth2normal", version("depth2normal"))
print("16 bits, slope of 1 code a texel: largest code 255: {:.1f} degrees; 256: {:.1f} degrees".format(*tilts[:2]))
print("float, slope of 1/64 a texel: largest value 1.0: {:.1f} degrees; 1.02: {:.1f} degrees".format(*tilts[2:]))
print(f"height rising upwards: green {upwards[1]}; flat: {flat}")
assert abs(tilts[0] - 45) < 1 and tilts[1] < 0.6 and tilts[2] > 70 and tilts[3] < 2, "changed"
assert upwards[1] > 200, "changed"
assert flat == (127, 127, 255), "changed"
PY
