#!/usr/bin/env bash
# PyPBR's conversion from metallic to specular decodes F0 and normals twice, and back makes metals black.
#
# Behaviour: to_diffuse_specular_material() computes F0 in linear light and marks it as sRGB: 0.04 is
# read as 0.0031 by the renderer. Normals, already -1 to 1, are decoded from 0 to 1 once more: a flat
# map leans by 55 degrees. to_basecolor_metallic_material() takes what has no diffuse colour for a
# dielectric: a metal of 0.9 comes back with metallic 0 and base colour 0. No warning is given.
# Why it matters: PyPBR handles captured materials in PyTorch, and data sets come in both
# workflows. Converted targets have another gloss and another shape, and no metals.
# Seen on 2026-12-01:
#   pypbr 0.1.0b5, torch 2.14.1
#   dielectric: F0 0.0031 (0.0400 expected), flat normal leans by 54.7 degrees (0.0)
#   metal of 0.90, there and back: base colour 0.00, metallic 0.00 (0.90, 1.00)
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check pypbr==0.1.0b5 torch==2.14.1 torchvision==0.29.1 numpy==2.4.6
venv/bin/python - <<'PY'
import math
from importlib.metadata import version

import torch
from pypbr.materials import BasecolorMetallicMaterial


def flat(*values):
    return torch.tensor(values).view(-1, 1, 1).expand(-1, 4, 4).clone()


def material(colour, metallic):
    return BasecolorMetallicMaterial(albedo=flat(*[colour] * 3), albedo_is_srgb=False, metallic=flat(metallic),
                                     roughness=flat(0.5), normal=flat(0.5, 0.5, 1.0))


plastic = material(0.2, 0.0)
specular = plastic.to_diffuse_specular_material()
before, f0 = float(plastic.normal[2, 0, 0]), float(specular.linear_specular[0, 0, 0])
lean = math.degrees(math.acos(float(specular.normal[2, 0, 0])))
back = material(0.9, 1.0).to_diffuse_specular_material().to_basecolor_metallic_material()
colour, metallic = float(back.linear_albedo[0, 0, 0]), float(back.metallic[0, 0, 0])
print(f"pypbr {version('pypbr')}, torch {torch.__version__.split('+')[0]}")
print(f"dielectric: F0 {f0:.4f} (0.0400 expected), flat normal leans by {lean:.1f} degrees (0.0)")
print(f"metal of 0.90, there and back: base colour {colour:.2f}, metallic {metallic:.2f} (0.90, 1.00)")
assert before == 1 and f0 < 0.004 and lean > 50 and colour < 0.01 and metallic < 0.01, "changed"
PY
