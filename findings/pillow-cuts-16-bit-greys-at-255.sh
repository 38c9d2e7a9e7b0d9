#!/usr/bin/env bash
# Pillow's convert("L") and convert("RGB") cut greys of 16 bits at 255: a roughness map becomes white.
#
# Behaviour: a grey PNG or TIFF of 16 bits opens as I;16. Converted to L or RGB its codes are not
# divided by 257 but limited: all above 255 of 65535 is white. RGB files of 16 bits are scaled when
# they are opened. No warning is given. convert("F") keeps the codes.
# Why it matters: height, roughness and metallic maps come as greys of 16 bits, and loaders of
# material data sets call convert("L") or convert("RGB") on all they open. Roughness is then 1
# everywhere and the height flat.
# Seen on 2026-12-01:
#   Pillow 13.0.0
#   codes 128, 16448, 32896, 65535: L 128 255 255 255, RGB 128 255 255 255 (0 64 128 255 expected)
#   convert("F"): 128 16448 32896 65535
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check pillow==13.0.0 numpy==2.4.6
venv/bin/python - <<'PY'
import numpy as np, PIL
from PIL import Image

codes = np.array([[128, 16448, 32896, 65535]], np.uint16)
Image.fromarray(codes).save("rough.png")
Image.fromarray(codes).save("rough.tif")


def converted(name, mode):
    image = Image.open(name)
    assert image.mode == "I;16", "changed"
    values = np.asarray(image.convert(mode))
    return [int(value) for value in (values[0, :, 0] if mode == "RGB" else values[0])]


grey, colour = (converted("rough.png", mode) for mode in ("L", "RGB"))
kept = converted("rough.png", "F")
print("Pillow", PIL.__version__)
print("codes 128, 16448, 32896, 65535: L", *grey, end="")
print(", RGB", *colour, "(0 64 128 255 expected)")
print('convert("F"):', *kept)
assert grey == colour == converted("rough.tif", "L") == [128, 255, 255, 255] and kept == list(codes[0]), "changed"
PY
