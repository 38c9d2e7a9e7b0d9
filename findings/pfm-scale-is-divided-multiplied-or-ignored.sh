#!/usr/bin/env bash
# A PFM's scale is divided out by OpenCV, multiplied by OpenImageIO and Mitsuba, ignored by Pillow.
#
# Behaviour: the third line of a PFM holds the byte order in its sign and a scale in its size; rows
# run from the bottom up. The same file with scale 2.5 has three contents in four readers, without
# a warning. OpenImageIO also turns it upside down when it is opened plainly (ImageInput.open(name),
# ImageBuf(name)); with any hints, even none set, and through ImageCache the rows are right.
# Why it matters: depth and height maps of stereo data sets and reconstructions are PFM, with scales
# in use. Relief is 6.25 times too deep, and a map that is turned over is lit from below.
# Seen on 2026-12-01:
#   OpenCV 5.0.0, OpenImageIO 3.2.2.0, Mitsuba 3.9.1, Pillow 13.0.0
#   top 4, bottom 1, scale 2.5: OpenCV 1.6, 0.4; Mitsuba 10.0, 2.5; Pillow 4.0, 1.0; OpenImageIO 2.5, 10.0
#   OpenImageIO with empty hints 10.0, 2.5; through ImageCache 10.0, 2.5
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93 \
    OpenImageIO==3.2.2.0 mitsuba==3.9.1 pillow==13.0.0 numpy==2.4.6
venv/bin/python - <<'PY'
from pathlib import Path

import cv2, mitsuba, numpy as np, OpenImageIO as oiio, PIL
from PIL import Image

mitsuba.set_variant("scalar_rgb")
heights = np.repeat(np.float32([[4], [1]]), 2, axis=1)
Path("height.pfm").write_bytes(b"Pf\n2 2\n-2.5\n" + heights[::-1].astype("<f4").tobytes())


def ends(image):
    """First and last row, from the top."""
    column = np.asarray(image, np.float64).reshape(2, -1)[:, 0]
    return tuple(round(float(value), 2) for value in column)


found = {"OpenCV": ends(cv2.imread("height.pfm", cv2.IMREAD_UNCHANGED)),
         "Mitsuba": ends(mitsuba.Bitmap("height.pfm")), "Pillow": ends(Image.open("height.pfm")),
         "OpenImageIO": ends(oiio.ImageInput.open("height.pfm").read_image("float"))}
hinted = ends(oiio.ImageInput.open("height.pfm", oiio.ImageSpec()).read_image("float"))
cached = ends(oiio.ImageCache().get_pixels("height.pfm", 0, 0, 0, 2, 0, 2))
print(f"OpenCV {cv2.__version__}, OpenImageIO {oiio.__version__}, Mitsuba {mitsuba.__version__}, "
      f"Pillow {PIL.__version__}")
print("top 4, bottom 1, scale 2.5: " + "; ".join(f"{name} {a}, {b}" for name, (a, b) in found.items()))
print(f"OpenImageIO with empty hints {hinted[0]}, {hinted[1]}; through ImageCache {cached[0]}, {cached[1]}")
assert list(found.values()) == [(1.6, 0.4), (10.0, 2.5), (4.0, 1.0), (2.5, 10.0)], "changed"
assert hinted == cached == (10.0, 2.5), "changed"
PY
