#!/usr/bin/env bash
# White of a 10-bit picture is 1023 by OpenCV (AVIF) and 65472 by pillow-heif (HEIC), both in uint16.
#
# Behaviour: cv2.imread(IMREAD_UNCHANGED) returns 10-bit AVIF as uint16 with the codes as they are,
# while its PNG and TIFF of 16 bits end at 65535. pillow-heif (convert_hdr_to_8bit=False) shifts 10-bit
# codes left by 6: white is 65472. Divided by np.iinfo(dtype).max, the rule for uint16, white is
# 0.0156 and 0.99904.
# Why it matters: phones take 10-bit AVIF and HEIC. A dark picture with correct structure looks like an
# underexposed photograph, not like an error; and light taken as 100 % is clipped or not by 0.1 %, so a
# test for saturation (code == 65535) finds none.
# Seen on 2026-11-29:
#   OpenCV 5.0.0, pillow-heif 1.8.1
#   white of 10 bits: OpenCV (AVIF) uint16 1023, pillow-heif (HEIC) uint16 65472, of 65535
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93 pillow-heif==1.8.1 pillow==13.0.0 numpy==2.4.6
venv/bin/python - <<'PY'
import cv2, numpy as np, pillow_heif

white = np.full((64, 64, 3), 1023, np.uint16)
options = [cv2.IMWRITE_AVIF_DEPTH, 10, cv2.IMWRITE_AVIF_QUALITY, 100]
assert cv2.imwrite("white.avif", white, options)
avif = cv2.imread("white.avif", cv2.IMREAD_UNCHANGED)
full = np.full((64, 64, 3), 65535, np.uint16)
pillow_heif.from_bytes("RGB;16", (64, 64), full.tobytes()).save("white.heic", quality=-1)
heic = np.asarray(pillow_heif.open_heif("white.heic", convert_hdr_to_8bit=False))
print(f"OpenCV {cv2.__version__}, pillow-heif {pillow_heif.__version__}")
print(f"white of 10 bits: OpenCV (AVIF) {avif.dtype} {avif.max()}, "
      f"pillow-heif (HEIC) {heic.dtype} {heic.max()}, of 65535")
assert avif.dtype == heic.dtype == np.uint16, "the behaviour has changed"
assert avif.max() == 1023 and heic.max() == 65472, "the behaviour has changed"
PY
