#!/usr/bin/env bash
# TIFF of MinIsWhite is inverted at 8 bits and left as it is at 16, by Pillow, OpenCV and OpenImageIO.
#
# Behaviour: PhotometricInterpretation 0 (MinIsWhite) says that code 0 is white, at every depth. All
# three readers return 255 - code for 8 bits; for 16 bits Pillow and OpenCV return the code itself,
# and so does OpenImageIO, without a warning. tifffile, which returns stored values, never inverts.
# Why it matters: scanners and GIS write heights and masks so. The same map, saved at 16 bits for
# its precision, is relief turned inside out: grooves are ridges, glossy is rough.
# Seen on 2026-12-01:
#   Pillow 13.0.0, OpenCV 5.0.0, OpenImageIO 3.2.2.0
#   8 bits, code 10 (0.961 of white): Pillow 0.961, OpenCV 0.961, OpenImageIO 0.961
#   16 bits, code 2570 (0.961 of white): Pillow 0.039, OpenCV 0.039, OpenImageIO 0.039
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check --no-compile pillow==13.0.0 opencv-python-headless==5.0.0.93 OpenImageIO==3.2.2.0 tifffile==2026.3.3 numpy==2.4.6
venv/bin/python - <<'PY'
import cv2, numpy as np, OpenImageIO as oiio, PIL, tifffile
from PIL import Image

print(f"Pillow {PIL.__version__}, OpenCV {cv2.__version__}, OpenImageIO {oiio.__version__}")
for depth, code, expected in ((8, 10, True), (16, 10 * 257, False)):
    white = 2**depth - 1
    tifffile.imwrite("map.tif", np.full((8, 8), code, f"uint{depth}"), photometric="miniswhite")
    assert tifffile.imread("map.tif")[0, 0] == code
    read = {
        "Pillow": float(np.asarray(Image.open("map.tif"))[0, 0]) / white,
        "OpenCV": float(cv2.imread("map.tif", cv2.IMREAD_UNCHANGED)[0, 0]) / white,
        "OpenImageIO": float(oiio.ImageBuf("map.tif").get_pixels(oiio.FLOAT)[0, 0, 0]),
    }
    right = 1 - code / white
    print(f"{depth} bits, code {code} ({right:.3f} of white): "
          + ", ".join(f"{name} {value:.3f}" for name, value in read.items()))
    assert all(abs(value - (right if expected else 1 - right)) < 1e-3 for value in read.values()), "changed"
PY
