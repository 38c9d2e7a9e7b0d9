#!/usr/bin/env bash
# Pillow reads and writes BC5 normal maps as RGB with blue 0: every normal points into the surface.
#
# Behaviour: BC5 holds two channels, x and y, and z follows from them. Pillow drops blue on saving
# (pixel_format="BC5") and opens the file as RGB, not LA or two bands, with blue 0, that is z = -1
# where flat is +1. imagecodecs returns two channels. OpenImageIO does not open Pillow's file, whose
# DXGI format is the typeless 82; with 83 (UNORM) in its place it opens as R and G.
# Why it matters: BC5 is what engines hold normal maps in. A texture set opened in Pillow to be
# resized, packed or converted has black or inverted shading, and its colours look merely yellow.
# Seen on 2026-12-01:
#   Pillow 13.0.0, imagecodecs 2026.3.6, OpenImageIO 3.2.2.0
#   saved (200, 128, 233), Pillow RGB (200, 128, 0): z is -1.00 where x and y say 0.82
#   imagecodecs (200, 128); OpenImageIO: Unsupported DXGI format: 82; as 83: R, G (200, 128)
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check --no-compile pillow==13.0.0 imagecodecs==2026.3.6 OpenImageIO==3.2.2.0 numpy==2.4.6
venv/bin/python - <<'PY'
import imagecodecs, numpy as np, OpenImageIO as oiio, PIL
from PIL import Image

colour = (200, 128, 233)
Image.new("RGB", (8, 8), colour).save("normal.dds", pixel_format="BC5")
picture = Image.open("normal.dds")
read = tuple(int(v) for v in np.asarray(picture)[0, 0])
x, y, z = (v / 127.5 - 1 for v in read)
data = open("normal.dds", "rb").read()
by_imagecodecs = tuple(int(v) for v in imagecodecs.dds_decode(data)[0, 0])
refused = oiio.ImageInput.open("normal.dds") is None
reason = oiio.geterror().removeprefix("Could not open file: ")
open("unorm.dds", "wb").write(data[:128] + (83).to_bytes(4, "little") + data[132:])
unorm = oiio.ImageInput.open("unorm.dds")
names, pixel = unorm.spec().channelnames, tuple(int(v) for v in unorm.read_image(oiio.UINT8)[0, 0])
print(f"Pillow {PIL.__version__}, imagecodecs {imagecodecs.__version__}, OpenImageIO {oiio.__version__}")
print(f"saved {colour}, Pillow {picture.mode} {read}: z is {z:.2f} where x and y say {(1 - x * x - y * y) ** 0.5:.2f}")
print(f"imagecodecs {by_imagecodecs}; OpenImageIO: {reason}; as 83: {', '.join(names)} {pixel}")
assert picture.mode == "RGB" and read == (200, 128, 0) and by_imagecodecs == (200, 128), "changed"
assert refused and "82" in reason and pixel == (200, 128), "changed"
PY
