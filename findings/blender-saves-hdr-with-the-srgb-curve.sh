#!/usr/bin/env bash
# Blender saves float images to Radiance files with the sRGB curve, and reads them without it.
#
# Behaviour: images.new(float_buffer=True) has the colour space "sRGB" and holds linear pixels.
# save() encodes by that colour space, whatever the format: a pixel of 0.5 is 0.734 in the .hdr,
# which is read back as "Linear Rec.709", 0.734; 4.0 becomes 1.82. With is_data=True 0.5 stays 0.5.
# Reading is split as well: `pixels` of an 8-bit PNG are its code values, those of the same PNG at
# 16 bits linear, though both have the colour space "sRGB".
# Why it matters: albedo, irradiance and environment maps are baked into such an image and saved
# for another program; scripts that read `pixels` get albedo of another curve from 16-bit maps.
# Seen on 2026-11-30 (bpy 5.0.1 needs Python 3.11):
#   Blender 5.0.1
#   saved 0.5: in the .hdr 0.734 (with is_data 0.500), read back by Blender as Linear Rec.709 0.734
#   saved 4.0: in the .hdr 1.820
#   sRGB code 0.502: pixels of 8 bits 0.502, of 16 bits 0.216
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check bpy==5.0.1 pillow==13.0.0 numpy==1.26.4
venv/bin/python - <<'PY'
from pathlib import Path

import bpy, numpy as np
from PIL import Image

here = Path.cwd()


def saved(value, is_data=False):
    path = str(here / f"{value}-{is_data}.hdr")
    image = bpy.data.images.new("baked", 4, 4, float_buffer=True, is_data=is_data)
    image.pixels.foreach_set(np.full(64, value, np.float32))
    image.filepath_raw, image.file_format = path, "HDR"
    image.save()
    again = bpy.data.images.load(path)
    red, _, _, exponent = Path(path).read_bytes()[-4:]  # rows of 4 pixels are stored as they are
    return red * 2.0 ** (exponent - 136), again.pixels[0], again.colorspace_settings.name


def pixel(code):
    path = str(here / f"{code.dtype}.png")
    Image.fromarray(np.full((4, 4), code)).save(path)
    image = bpy.data.images.load(path)
    assert image.colorspace_settings.name == "sRGB", "changed"
    return image.pixels[0]


half, again, space = saved(0.5)
data, _, _ = saved(0.5, is_data=True)
bright, _, _ = saved(4.0)
byte, word = pixel(np.uint8(128)), pixel(np.uint16(128 * 257))
print("Blender", bpy.app.version_string)
print(f"saved 0.5: in the .hdr {half:.3f} (with is_data {data:.3f}), read back by Blender as {space} {again:.3f}")
print(f"saved 4.0: in the .hdr {bright:.3f}")
print(f"sRGB code {128 / 255:.3f}: pixels of 8 bits {byte:.3f}, of 16 bits {word:.3f}")
assert abs(half - 0.735) < 0.01 and abs(again - half) < 0.01 and bright < 2 and data == 0.5, "changed"
assert abs(byte - 0.502) < 0.001 and abs(word - 0.216) < 0.001, "changed"
PY
