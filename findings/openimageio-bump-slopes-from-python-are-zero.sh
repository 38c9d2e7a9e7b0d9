#!/usr/bin/env bash
# OpenImageIO's make_texture writes bump slopes of zero from Python, where its maketx writes slopes.
#
# Behaviour: ImageBufAlgo.make_texture(MakeTxBumpWithSlopes) returns True and writes a texture of six
# channels (h, dhds, dhdt and second moments), all 0, for heights and for normal maps. The command
# maketx --bumpslopes of the same package writes them. There t runs down the picture, and of normal
# maps green is taken so too: an OpenGL map (+Y up) gets dhdt of the wrong sign, a DirectX one the right.
# Why it matters: renderers read such textures for bump to roughness. From Python, surfaces come out
# perfectly flat without an error; from an OpenGL map lit from above as if from below.
# Seen on 2026-12-01:
#   OpenImageIO 3.2.2.0
#   height rising by 0.25 to the right, 0.50 down: dhds 0.00, dhdt 0.00 by make_texture; 0.25, 0.50 by maketx
#   the same as OpenGL normals: 0.00, 0.00 by make_texture; 0.25, -0.50 by maketx
#   the same as DirectX normals: 0.00, 0.00 by make_texture; 0.25, 0.50 by maketx
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check --no-compile OpenImageIO==3.2.2.0 numpy==2.4.6
venv/bin/python - <<'PY'
import subprocess

import numpy as np, OpenImageIO as oiio

row, column = np.mgrid[0:64, 0:64]


def normals(green):
    normal = np.array([-0.25, green, 1.0])
    return np.broadcast_to(0.5 + 0.5 * normal / np.linalg.norm(normal), (64, 64, 3))


def slopes(path):
    return tuple(float(v) for v in oiio.ImageInput.open(path).read_image(oiio.FLOAT)[31, 31, 1:3])


print("OpenImageIO", oiio.__version__)
for name, pixels, kind, down in (
    ("height rising by 0.25 to the right, 0.50 down: dhds", (0.25 * column + 0.5 * row)[..., None], "height", 0.5),
    ("the same as OpenGL normals:", normals(0.5), "normal", -0.5),
    ("the same as DirectX normals:", normals(-0.5), "normal", 0.5),
):
    oiio.ImageBuf(np.ascontiguousarray(pixels, dtype=np.float32)).write("map.exr")
    options = oiio.ImageSpec()
    options.attribute("maketx:bumpformat", kind)
    done = oiio.ImageBufAlgo.make_texture(oiio.MakeTxBumpWithSlopes, "map.exr", "python.exr", options)
    words = ["venv/bin/maketx", "--bumpslopes", "--bumpformat", kind, "map.exr", "-o", "command.exr"]
    subprocess.run(words, check=True)
    (s, t), (right_s, right_t) = slopes("python.exr"), slopes("command.exr")
    also = " dhdt" if kind == "height" else ""
    print(f"{name} {s:.2f},{also} {t:.2f} by make_texture; {right_s:.2f}, {right_t:.2f} by maketx")
    assert done and s == t == 0 and abs(right_s - 0.25) < 0.01 and abs(right_t - down) < 0.01, "changed"
PY
