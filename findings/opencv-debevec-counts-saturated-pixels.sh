#!/usr/bin/env bash
# OpenCV's MergeDebevec counts saturated pixels: what is dark in one exposure gets 28 % too bright.
#
# Behaviour: the weight of code 255 is 1, not 0 (of 0 too). Of a bracket of 1/256 s and 1 s, a
# point whose short exposure has code 2 is saturated in the long one, and still averages with it:
# (3 log(2 / t) + 1 log(255 / T)) / 4. Its radiance comes out 28 % too high, as a clipped
# exposure is taken for light. Absolute scale is arbitrary: here it is divided by the median.
# Why it matters: a flash highlight on a dark material is such a bracket: the short exposure has the
# highlight alone, all around it is dark there and the long one is clipped near it. The flank of
# the highlight, from which roughness is estimated, is raised.
# Seen on 2026-11-29:
#   OpenCV 5.0.0
#   codes 2 and 255: radiance 1.278 times the scene's; codes 48 and 255: 0.999; codes 0 and 128: 1.000
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93 numpy==2.4.6
venv/bin/python - <<'PY'
import cv2, numpy as np

scene = np.tile(np.array([0.5, 1.5653, 48.03] + [60.0] * 29, np.float32), (8, 1))
times = np.array([1 / 256, 1], np.float32)
frames = [
    np.repeat(np.clip(np.rint(255 * scene * time), 0, 255).astype(np.uint8)[..., None], 3, axis=2)
    for time in times
]
merged = cv2.createMergeDebevec().process(frames, times)[4, :, 0] / scene[4]
merged /= np.median(merged)
print("OpenCV", cv2.__version__)
codes = [(int(frames[0][4, at, 0]), int(frames[1][4, at, 0])) for at in range(3)]
print("; ".join(f"codes {a} and {b}: {'radiance ' if at == 1 else ''}{merged[at]:.3f}"
                f"{' times the scene' + chr(39) + 's' if at == 1 else ''}"
                for at, (a, b) in ((1, codes[1]), (2, codes[2]), (0, codes[0]))))
assert codes[1] == (2, 255) and merged[1] > 1.2 and abs(merged[2] - 1) < 0.02, "changed"
PY
