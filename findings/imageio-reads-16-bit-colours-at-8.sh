#!/usr/bin/env bash
# imageio and scikit-image read an RGB PNG of 16 bits at 8 bits; grey ones keep their 16.
#
# Behaviour: both read PNG through Pillow, which has no mode for RGB of 16 bits and drops the low
# byte on opening. Nothing is printed. A grey PNG of 16 bits comes as uint16, so code that looks at
# dtype for one map of a set is wrong for the next.
# Why it matters: normal maps and base colours are exchanged as 16-bit RGB PNG. At 8 bits a normal
# map has steps of 0.45 degrees, which show as bands in highlights of smooth materials, and the dark
# end of a linear albedo is lost. (OpenCV, OpenImageIO and tifffile keep 16 bits.)
# Seen on 2026-11-29:
#   imageio 2.38.1, scikit-image 0.26.0, Pillow 13.0.0
#   RGB of 16 bits: imageio uint8, 256 levels; scikit-image uint8; grey of 16 bits: imageio uint16
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check imageio==2.38.1 scikit-image==0.26.0 pillow==13.0.0 numpy==2.4.6
venv/bin/python - <<'PY'
import struct, zlib
import imageio, imageio.v3, numpy as np, PIL, skimage, skimage.io

def png(path, codes):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    height, width = codes.shape[:2]
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in codes)
    header = struct.pack(">IIBBBBB", width, height, 16, 2 if codes.ndim == 3 else 0, 0, 0, 0)
    path_bytes = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header)
    with open(path, "wb") as file:
        file.write(path_bytes + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))

ramp = np.tile(np.arange(65536, dtype=np.uint16).reshape(256, 256)[..., None], (1, 1, 3))
png("normal.png", ramp)
png("height.png", ramp[..., 0])
colours, grey = imageio.v3.imread("normal.png"), imageio.v3.imread("height.png")
other = skimage.io.imread("normal.png")
print(f"imageio {imageio.__version__}, scikit-image {skimage.__version__}, Pillow {PIL.__version__}")
print(f"RGB of 16 bits: imageio {colours.dtype}, {np.unique(colours).size} levels; "
      f"scikit-image {other.dtype}; grey of 16 bits: imageio {grey.dtype}")
assert colours.dtype == other.dtype == np.uint8 and grey.dtype == np.uint16, "changed"
PY
