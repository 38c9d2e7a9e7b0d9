#!/usr/bin/env bash
# torchvision makes 0 of white when floats become 16 bits, and negative numbers of 16-bit greys above half.
#
# Behaviour: transforms.v2 to_dtype(x, torch.uint16, scale=True) multiplies by 65535.999, which is 65536
# in float32: 1.0 becomes 0, its neighbours 65535. In float64, and to uint8 and int16, white is right.
# uint8 to uint16 shifts: 255 becomes 65280, 0.4 % too dark. ToTensor() and to_tensor() read a 16-bit
# grey picture of Pillow as int16 and do not scale it: 33287 is -32249. No warning is given; pil_to_tensor
# and torchvision.io.read_image are right.
# Why it matters: a height or roughness map that is normalised to 0..1 and written at 16 bits has holes at
# its summits, and one that is read with ToTensor has its upper half below its lower half.
# Seen on 2026-12-01:
#   torchvision 0.29.1, torch 2.14.1, Pillow 13.0.0
#   0, 0.5, 0.9999, 1 to uint16: 0, 32768, 65529, 0 from float32; 0, 32767, 65529, 65535 from float64
#   0, 0.5, 0.9999, 1 to uint8: 0, 127, 255, 255; 255 from uint8 to uint16 to float: 0.9961
#   16-bit grey 16643, 33287, 65535: ToTensor 16643, -32249, -1; pil_to_tensor 16643, 33287, 65535
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check torch==2.14.1 torchvision==0.29.1 pillow==13.0.0 numpy==2.4.6
venv/bin/python - <<'PY'
import numpy as np, PIL, torch, torchvision
from PIL import Image
from torchvision.transforms import ToTensor
from torchvision.transforms.functional import pil_to_tensor
from torchvision.transforms.v2.functional import to_dtype

heights = [0, 0.5, 0.9999, 1]


def converted(start, end):
    """The heights after conversion; 256 of each, as vector instructions and single ones may differ."""
    values = torch.tensor(heights, dtype=start)[:, None].repeat(1, 256)
    result = to_dtype(values, end, scale=True).to(torch.int64)
    assert bool((result == result[:, :1]).all())
    return result[:, 0].tolist()


def listed(values):
    return ", ".join(map(str, values))


single, double = converted(torch.float32, torch.uint16), converted(torch.float64, torch.uint16)
byte = converted(torch.float32, torch.uint8)
white = float(to_dtype(to_dtype(torch.tensor([255], dtype=torch.uint8), torch.uint16, scale=True), torch.float32, scale=True)[0])
greys = [16643, 33287, 65535]
Image.fromarray(np.array([greys], np.uint16)).save("height.png")
signed, right = ([int(v) for v in read(Image.open("height.png")).ravel()] for read in (ToTensor(), pil_to_tensor))
print(f"torchvision {torchvision.__version__.split('+')[0]}, torch {torch.__version__.split('+')[0]}, Pillow {PIL.__version__}")
print(f"{listed(heights)} to uint16: {listed(single)} from float32; {listed(double)} from float64")
print(f"{listed(heights)} to uint8: {listed(byte)}; 255 from uint8 to uint16 to float: {white:.4f}")
print(f"16-bit grey {listed(greys)}: ToTensor {listed(signed)}; pil_to_tensor {listed(right)}")
assert single[-1] == 0 and double[-1] == 65535 and byte[-1] == 255 and round(white, 4) == 0.9961, "changed"
assert signed == [16643, -32249, -1] and right == greys, "changed"
PY
