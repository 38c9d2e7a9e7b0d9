#!/usr/bin/env bash
# PyPBR's normals of a height map lean the wrong way in x, and its heights of normals are upside down in y.
#
# Behaviour: compute_normal_from_height() gives (2 dh/dx, -2 dh/dy, 1), y up: twice the slope, and
# along x towards the summit, where its documentation says (-dh/dx, -dh/dy, 1).
# compute_height_from_normal() has x right and, of OpenGL normals, hills for valleys along y. Both
# conventions are wrong alike, since the sign is turned in the map and in the formula.
# Why it matters: PyPBR handles captured materials in PyTorch. Relief is lit from the right
# where the light is on the left, and a height map of true normals is a saddle where there was a dome.
# Seen on 2026-12-01:
#   pypbr 0.1.0b5, torch 2.14.1
#   normals of heights, slope 0.10: x +0.20 (-0.10 expected), y -0.20 (-0.10)
#   heights of true normals, correlation with the heights: waves along x +1.00, along y -1.00
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check pypbr==0.1.0b5 torch==2.14.1 torchvision==0.29.1 numpy==2.4.6
venv/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np, torch
from pypbr.utils import NormalConvention, compute_height_from_normal, compute_normal_from_height

down, right = np.mgrid[:64, :64].astype(np.float64)


def lean(height, axis, convention):
    """Slope that the normal in the middle stands for: x right, y up (OpenGL) or down (DirectX)."""
    normal = compute_normal_from_height(torch.tensor(height[None], dtype=torch.float32), 1.0, convention)
    return float(normal[axis, 32, 32] / normal[2, 32, 32])


def recovered(height, convention):
    """Correlation of a height map with what is recovered from its own normals."""
    across, rows = np.gradient(height, axis=1), np.gradient(height, axis=0)
    up = rows if convention == NormalConvention.OPENGL else -rows
    normal = np.stack([-across, up, np.ones_like(height)])
    normal /= np.linalg.norm(normal, axis=0)
    found = compute_height_from_normal(torch.tensor(normal, dtype=torch.float32), 1.0, convention)
    return float(np.corrcoef(found.numpy().ravel(), height.ravel())[0, 1])


opengl, directx = NormalConvention.OPENGL, NormalConvention.DIRECTX
x, y = lean(0.1 * right, 0, opengl), lean(-0.1 * down, 1, opengl)
waves = [recovered(np.sin(2 * np.pi * at / 64), opengl) for at in (right, down)]
print(f"pypbr {version('pypbr')}, torch {torch.__version__.split('+')[0]}")
print(f"normals of heights, slope 0.10: x {x:+.2f} (-0.10 expected), y {y:+.2f} (-0.10)")
print(f"heights of true normals, correlation with the heights: waves along x {waves[0]:+.2f}, along y {waves[1]:+.2f}")
assert abs(x - 0.2) < 0.01 and abs(y + 0.2) < 0.01 and waves[0] > 0.99 and waves[1] < -0.99, "changed"
assert lean(0.1 * right, 0, directx) > 0.19 and lean(-0.1 * down, 1, directx) > 0.19, "changed"
assert recovered(np.sin(2 * np.pi * down / 64), directx) < -0.99, "changed"
PY
