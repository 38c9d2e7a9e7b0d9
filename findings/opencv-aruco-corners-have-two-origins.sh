#!/usr/bin/env bash
# OpenCV's corners of ArUco markers are half a pixel off or a pixel too near together, by refinement.
#
# Behaviour: ArucoDetector gives corners in pixels whose centres are whole numbers with
# CORNER_REFINE_SUBPIX, to 0.1 pixels. CORNER_REFINE_APRILTAG counts from the corner of the first
# pixel: every corner is 0.5 pixels too far right and down. CORNER_REFINE_NONE, the default, and
# CONTOUR give the outermost dark pixels: the marker is a pixel too small. The documentation names
# no origin, and warpPerspective, solvePnP and cornerSubPix take whole numbers for centres.
# Why it matters: markers are printed beside a sample for its homography and for millimetres per texel.
# Between two frames with different refinements the sample moves by 0.7 pixels; a marker of 60 pixels
# measured by default makes every length 1.7 % too large.
# Seen on 2026-12-01:
#   OpenCV 5.0.0
#   marker of 60 pixels, edges at 199.50 and 259.50 (centres are whole numbers)
#   NONE 200.00 259.00; SUBPIX 199.59 259.41; CONTOUR 200.00 259.00; APRILTAG 200.00 260.00
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check --no-compile opencv-python-headless==5.0.0.93 numpy==2.4.6
venv/bin/python - <<'PY'
import cv2, numpy as np

words = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
picture = np.full((480, 640), 255, np.uint8)
picture[200:260, 200:260] = cv2.aruco.generateImageMarker(words, 3, 60)


def ends(refinement):
    """Left, right edge of the marker, which is symmetric: the mean over x and y."""
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = getattr(cv2.aruco, "CORNER_REFINE_" + refinement)
    corners = cv2.aruco.ArucoDetector(words, settings).detectMarkers(picture)[0][0][0]
    low = np.mean([corners[0, 0], corners[3, 0], corners[0, 1], corners[1, 1]])
    high = np.mean([corners[1, 0], corners[2, 0], corners[2, 1], corners[3, 1]])
    return float(low), float(high)


found = {name: ends(name) for name in ("NONE", "SUBPIX", "CONTOUR", "APRILTAG")}
print("OpenCV", cv2.__version__)
print("marker of 60 pixels, edges at 199.50 and 259.50 (centres are whole numbers)")
print("; ".join(f"{name} {low:.2f} {high:.2f}" for name, (low, high) in found.items()))
assert np.allclose(found["SUBPIX"], (199.5, 259.5), atol=0.1), "changed"
assert np.allclose(found["APRILTAG"], (200, 260), atol=0.1), "changed"
assert np.allclose([found["NONE"], found["CONTOUR"]], (200, 259), atol=0.1), "changed"
PY
