#!/usr/bin/env bash
# rawpy (LibRaw) scales each RAW frame by its own brightest value, even with no_auto_bright=True.
#
# Behaviour: adjust_maximum_thr is 0.75 by default. Where the brightest photosite lies between 0.75
# and 1 of the white level, LibRaw takes it for the white level. Two frames of one scene, the second
# with 1.2 times the light, come out equal. adjust_maximum_thr=0 ends it.
# Why it matters: brackets, flash and no-flash pairs and several photographs of one material are
# compared by their linear values; scripts set gamma=(1, 1) and no_auto_bright=True and take the
# result for radiometric. The factor reaches 1.33, changes with each frame, and leaves no trace.
# Seen on 2026-11-29:
#   rawpy 0.28.0, LibRaw 0.22.2
#   light 1.200 times brighter: developed 1.000 times; with adjust_maximum_thr=0: 1.200 times
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
    (50706, 1, 4, b"\1\4\0\0", True),  # DNGVersion
    (50708, 2, 0, "Plain", True),  # UniqueCameraModel
    (33421, 3, 2, (2, 2), True),  # CFARepeatPatternDim
    (33422, 1, 4, b"\0\1\1\2", True),  # CFAPattern
    (50717, 4, 1, 16383, True),  # WhiteLevel
    (50721, 10, 9, sum(((value, 10**7) for value in matrix), ()), True),  # ColorMatrix1
    (50728, 5, 3, (1, 1) * 3, True),  # AsShotNeutral
]

def developed(gain, **options):
    scene = np.tile(np.linspace(0.05, 0.8, 320), (240, 1))
    mosaic = np.rint(scene * gain * 16383).astype(np.uint16)
    tifffile.imwrite("frame.dng", mosaic, photometric=32803, extratags=tags, metadata=None)
    with rawpy.imread("frame.dng") as raw:
        picture = raw.postprocess(
            gamma=(1, 1), no_auto_bright=True, output_bps=16, use_camera_wb=True, **options
        )
    return float(picture[120, 160, 1])

default = developed(1.2) / developed(1.0)
off = developed(1.2, adjust_maximum_thr=0) / developed(1.0, adjust_maximum_thr=0)
print(f"rawpy {rawpy.__version__}, LibRaw {'.'.join(map(str, rawpy.libraw_version))}")
print(f"light 1.200 times brighter: developed {default:.3f} times; "
      f"with adjust_maximum_thr=0: {off:.3f} times")
assert abs(off - 1.2) < 0.002 and abs(default - 1.0) < 0.002, "the behaviour has changed"
PY
