#!/usr/bin/env bash
# Whether DWAA compression of an EXR is lossy depends on the channel's name.
#
# Behaviour: OpenEXR's DWAA and DWAB code channels named R, G, B, Y, RY, BY (in any layer) with loss,
# by a curve made for colours, and all others without. The same height map is exact as channel Z or
# "height" and off by 0.006 as Y, in float32 as in half.
# Why it matters: libraries write single-channel maps as Y, and normal maps as R, G, B. A height or
# normal map saved with DWAA as the studio's default is damaged or not by the writer's choice of
# name; slopes, which are differences of heights, suffer most.
# Seen on 2026-11-29:
#   OpenEXR 3.5.3
#   largest error of a height map within +-0.5: as Y 0.00612, as displacement.Y 0.00612, as Z 0, as height 0
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check OpenEXR==3.5.3 numpy==2.4.6
venv/bin/python - <<'PY'
import numpy as np, OpenEXR

noise = np.fft.rfft2(np.random.default_rng(0).normal(size=(128, 128)))
distance = np.hypot(np.fft.fftfreq(128)[:, None], np.fft.rfftfreq(128)[None])
height = np.fft.irfft2(noise * np.exp(-((9.4 * distance) ** 2) / 2.0))
height = (0.5 * height / np.abs(height).max()).astype(np.float32)

def error(name):
    header = {"compression": OpenEXR.DWAA_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {name: height}).write("height.exr")
    with OpenEXR.File("height.exr") as file:
        (channel,) = file.channels().values()
        return float(np.abs(np.array(channel.pixels) - height).max())

errors = {name: error(name) for name in ("Y", "displacement.Y", "Z", "height")}
print("OpenEXR", OpenEXR.__version__)
print("largest error of a height map within +-0.5:",
      ", ".join(f"as {name} {value:.5f}" if value else f"as {name} 0" for name, value in errors.items()))
assert errors["Y"] > 1e-3 and errors["displacement.Y"] > 1e-3, "the behaviour has changed"
assert errors["Z"] == errors["height"] == 0.0, "the behaviour has changed"
PY
