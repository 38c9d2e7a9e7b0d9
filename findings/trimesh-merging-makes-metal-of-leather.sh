#!/usr/bin/env bash
# trimesh applies glTF's metallic factor to the wrong channel and wraps the colour when it merges.
#
# Behaviour: Scene.to_geometry() packs the textures of several materials into one. It multiplies
# the red channel by metallicFactor, though metallic is blue: a dielectric of factor 0 whose texture
# has 255 there becomes a metal. baseColorFactor is stored as 0 to 255 and multiplied as such: with
# the neutral factor 1 a code of 188 becomes 188 * 255, cut to 8 bits (68 on x86-64). Roughness is
# right. A texture without any factor comes through unchanged.
# Why it matters: several captured materials on one object are merged so for baking and export.
# Exporters that write the factors out, neutral ones too, get another albedo and another F0.
# Seen on 2026-11-30:
#   trimesh 5.2.0
#   loaded: factors 255, metallic 0.0, roughness 0.5 on code 188, roughness 128, metallic 255
#   merged: code 68 (188 expected), roughness 64 (64), metallic 255 (0)
#   merged beside it, without factors: code 188, roughness 128, metallic 255
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check trimesh==5.2.0 pillow==13.0.0 scipy==1.17.1 numpy==2.4.6
venv/bin/python - <<'PY'
import numpy as np, trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial


def tile(left, **factors):
    material = PBRMaterial(baseColorTexture=Image.new("RGB", (4, 4), (188, 188, 188)),
                           metallicRoughnessTexture=Image.new("RGB", (4, 4), (255, 128, 255)), **factors)
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    mesh = trimesh.Trimesh(np.c_[corners + (left, 0), np.zeros(4)], [(0, 1, 2), (0, 2, 3)], process=False)
    mesh.visual = TextureVisuals(uv=corners, material=material)
    return mesh


leather = tile(0, baseColorFactor=[1.0, 1.0, 1.0, 1.0], metallicFactor=0.0, roughnessFactor=0.5)
trimesh.Scene({"leather": leather, "steel": tile(2)}).export("two.glb")
scene = trimesh.load_scene("two.glb")
before = next(mesh.visual.material for mesh in scene.geometry.values()
              if mesh.visual.material.roughnessFactor == 0.5)
merged = scene.to_geometry()
maps = [np.asarray(image)[::-1] for image in
        (merged.visual.material.baseColorTexture, merged.visual.material.metallicRoughnessTexture)]


def seen(inside):
    """Codes of colour, roughness and metallic where the mean texture coordinate of the tile points."""
    at = merged.visual.uv[inside(merged.vertices[:, 0])].mean(axis=0) * maps[0].shape[1::-1]
    return [int(image[int(at[1]), int(at[0]), channel]) for image, channel in
            ((maps[0], 0), (maps[1], 1), (maps[1], 2))]


first, second = seen(lambda x: x < 1.5), seen(lambda x: x > 1.5)
print("trimesh", trimesh.__version__)
print(f"loaded: factors {before.baseColorFactor[0]}, metallic {before.metallicFactor}, "
      f"roughness {before.roughnessFactor} on code 188, roughness 128, metallic 255")
print(f"merged: code {first[0]} (188 expected), roughness {first[1]} (64), metallic {first[2]} (0)")
print(f"merged beside it, without factors: code {second[0]}, roughness {second[1]}, metallic {second[2]}")
factors = merged.visual.material.metallicFactor, merged.visual.material.baseColorFactor
assert first[0] != 188 and first[1:] == [64, 255] and factors == (None, None), "changed"
assert second == [188, 128, 255], "changed"
PY
