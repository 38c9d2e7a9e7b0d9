#!/usr/bin/env bash
# OpenCV and OpenImageIO leave the EXPOSURE of a Radiance HDR picture in its values.
#
# Behaviour: by the format's definition radiance is the stored value divided by the product of all
# EXPOSURE lines. OpenCV drops the lines; OpenImageIO returns stored values and keeps the number
# of one line as an attribute (hdr:exposure): of two lines, which multiply, the last alone.
# Why it matters: environment maps and HDR photographs that passed through pfilt, ximage or pcond
# have such lines. Read by either library a map of EXPOSURE=2 lights a scene twice as bright, and
# frames of a bracket, each with its own EXPOSURE, do not agree.
# Seen on 2026-11-29:
#   OpenCV 5.0.0, OpenImageIO 3.2.2.0
#   stored 1.0 with EXPOSURE=2 and EXPOSURE=4, that is radiance 0.125: OpenCV 1.0, OpenImageIO 1.0 (hdr:exposure 4.0)
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93 OpenImageIO==3.2.2.0 numpy==2.4.6
venv/bin/python - <<'PY'
import cv2, OpenImageIO as oiio

with open("sky.hdr", "wb") as file:
    file.write(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=2\nEXPOSURE=4\n\n-Y 8 +X 16\n")
    file.write(bytes([128, 128, 128, 129]) * (8 * 16))  # 1.0
by_opencv = float(cv2.imread("sky.hdr", cv2.IMREAD_UNCHANGED)[4, 8, 0])
picture = oiio.ImageBuf("sky.hdr")
by_openimageio = float(picture.get_pixels()[4, 8, 0])
stated = picture.spec().getattribute("hdr:exposure")
print(f"OpenCV {cv2.__version__}, OpenImageIO {oiio.__version__}")
print(f"stored 1.0 with EXPOSURE=2 and EXPOSURE=4, that is radiance {1 / 8}: OpenCV {by_opencv}, "
      f"OpenImageIO {by_openimageio} (hdr:exposure {stated})")
assert by_opencv == by_openimageio == 1.0, "the behaviour has changed"
PY
