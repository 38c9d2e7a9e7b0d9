#!/usr/bin/env bash
# OpenImageIO multiplies the colours of PNG, TGA, TIFF and WebP by alpha when it reads them.
#
# Behaviour: files with unassociated alpha are premultiplied on reading, in code values, unless the
# reader is opened with the hint oiio:UnassociatedAlpha. Where alpha is 0 the colours become 0 and
# cannot be recovered.
# Why it matters: map sets pack data into alpha: normal with roughness or height (Terrain3D), base
# colour with smoothness (Unity), metallic with smoothness. Read by OpenImageIO, and by the tools on
# it (maketx, oiiotool, texture systems of renderers), a flat normal with smoothness 0 becomes
# (0, 0, 0), which decodes to a normal that points into the surface.
# Seen on 2026-11-29:
#   OpenImageIO 3.2.2.0
#   stored normal and data (128, 128, 255, 64): read (32, 32, 64, 64)
#   with oiio:UnassociatedAlpha: (128, 128, 255, 64)
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check OpenImageIO==3.2.2.0 pillow==13.0.0 numpy==2.4.6
venv/bin/python - <<'PY'
import numpy as np, OpenImageIO as oiio
from PIL import Image

stored = (128, 128, 255, 64)
Image.new("RGBA", (8, 8), stored).save("normal_roughness.png")

def pixel(config):
    source = oiio.ImageInput.open("normal_roughness.png", config)
    return tuple(int(value) for value in source.read_image("uint8")[0, 0])

plain, hint = oiio.ImageSpec(), oiio.ImageSpec()
hint.attribute("oiio:UnassociatedAlpha", 1)
print("OpenImageIO", oiio.__version__)
print(f"stored normal and data {stored}: read {pixel(plain)}")
print(f"with oiio:UnassociatedAlpha: {pixel(hint)}")
assert pixel(hint) == stored and pixel(plain) == (32, 32, 64, 64), "the behaviour has changed"
PY
