#!/usr/bin/env bash
# rawpy's default output is called sRGB, and has the curve of BT.709.
#
# Behaviour: postprocess() defaults to output_color=sRGB with gamma=(2.222, 4.5), the camera curve of
# BT.709. No profile and no note says so. Decoded by the sRGB curve, as every reader of such a
# picture does, linear light is wrong; gamma=(2.4, 12.92) gives the curve of sRGB.
# Why it matters: RAWs are often developed by rawpy to PNG or JPEG and the pictures used as sRGB to
# recover albedo. Dark materials come out at 60 % of their reflectance, bright ones nearly right:
# contrast of the albedo and fall-off of the flash are both exaggerated.
# Seen on 2026-11-29:
#   rawpy 0.28.0
#   light 0.05: decoded as sRGB 0.029; light 0.20: 0.158; light 0.80: 0.777
#   with gamma=(2.4, 12.92): 0.050 0.200 0.800
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check rawpy==0.28.0 tifffile==2026.3.3 numpy==2.4.6
venv/bin/python - <<'PY'
import numpy as np, rawpy, tifffile

matrix = (32404542, -15371385, -4985314, -9692660, 18760108, 415560, 556434, -2040259, 10572252)
tags = [
    (50706, 1, 4, b"\1\4\0\0", True), (50708, 2, 0, "Plain", True),
    (33421, 3, 2, (2, 2), True), (33422, 1, 4, b"\0\1\1\2", True), (50717, 4, 1, 16383, True),
    (50721, 10, 9, sum(((value, 10**7) for value in matrix), ()), True),
    (50728, 5, 3, (1, 1) * 3, True),
]

def decoded(light, **options):
    mosaic = np.full((120, 160), round(light * 16383), np.uint16)
    tifffile.imwrite("grey.dng", mosaic, photometric=32803, extratags=tags, metadata=None)
    with rawpy.imread("grey.dng") as raw:
        codes = raw.postprocess(
            no_auto_bright=True, adjust_maximum_thr=0, use_camera_wb=True, output_bps=16, **options
        )
    code = float(codes[60, 80, 1]) / 65535
    return code / 12.92 if code <= 0.04045 else ((code + 0.055) / 1.055) ** 2.4

levels = (0.05, 0.2, 0.8)
default = [decoded(light) for light in levels]
srgb = [decoded(light, gamma=(2.4, 12.92)) for light in levels]
print(f"rawpy {rawpy.__version__}")
print("; ".join(f"light {light:.2f}: {'decoded as sRGB ' if not n else ''}{found:.3f}"
                for n, (light, found) in enumerate(zip(levels, default))))
print("with gamma=(2.4, 12.92):", *(f"{value:.3f}" for value in srgb))
assert default[0] < 0.035 and all(abs(a - b) < 0.003 for a, b in zip(srgb, levels)), "changed"
PY
