#!/usr/bin/env bash
# colour-hdri takes the first frame of a stack for the darkest, and counts what is saturated in it in full.
#
# Behaviour: image_stack_to_HDRI sets the weight of values above 0.5 to 1 in the first frame and of
# values below 0.5 to 1 in the last one, whatever their exposures. ImageStack.from_files sorts frames
# whose metadata it reads; a stack that is put together by append, or read with read_metadata=False
# and given exposures after, stays as it is. No warning is given.
# Why it matters: cameras bracket from bright to dark or from the middle. Highlights then come out at
# half their radiance, smoothly, and the roughness and F0 fitted to them are wrong.
# Seen on 2026-12-01:
#   colour-hdri 0.2.6, colour-science 0.4.7
#   radiance 0.05, 0.40, 2.00, 8.00 in frames of 1, 1/4 and 1/32 s
#   darkest first: 0.05, 0.40, 2.00, 8.00; brightest first: 0.05, 0.40, 1.67, 4.50
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check --no-compile colour-hdri==0.2.6 colour-demosaicing==0.2.7 colour-science==0.4.7 OpenImageIO==3.2.2.0 imageio==2.38.1 scipy==1.17.1 numpy==2.4.6
venv/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np
from colour_hdri import Image, ImageStack, Metadata, image_stack_to_HDRI

radiance = np.array([0.05, 0.4, 2.0, 8.0])


def merged(seconds):
    stack = ImageStack()
    for time in seconds:
        frame = np.clip(radiance * time, 0, 1)[None, :, None].repeat(3, axis=2)
        stack.append(Image(f"{time}.exr", frame, Metadata(np.array(1.0), np.array(time), np.array(100.0))))
    values = image_stack_to_HDRI(stack)[0, :, 1]
    return values / values[0] * radiance[0]


print(f"colour-hdri {version('colour-hdri')}, colour-science {version('colour-science')}")
print(f"radiance {', '.join(f'{v:.2f}' for v in radiance)} in frames of 1, 1/4 and 1/32 s")
dark, bright = merged([1 / 32, 1 / 4, 1.0]), merged([1.0, 1 / 4, 1 / 32])
print(f"darkest first: {', '.join(f'{v:.2f}' for v in dark)}; brightest first: {', '.join(f'{v:.2f}' for v in bright)}")
assert np.allclose(dark, radiance, rtol=1e-3) and np.allclose(bright, [0.05, 0.4, 5 / 3, 4.5], rtol=1e-3), "changed"
PY
