#!/usr/bin/env bash
# materialxgltf repeats colour and roughness of a glTF material, but not its normals, and drops factors.
#
# Behaviour: GLTF2MtlxReader applies KHR_texture_transform to baseColorTexture and
# metallicRoughnessTexture and looks for that of normalTexture in the wrong place: the same scale
# of 4 gives colours repeated 4 times on normals shown once. Where a texture is present,
# baseColorFactor, metallicFactor and roughnessFactor are not written, and the scale of normals
# never; all of them multiply the texture in glTF. The log says nothing.
# Why it matters: tiling materials carry such a transform, and factors set their level. In the
# MaterialX document relief and colour no longer belong together, and a roughness of half is whole.
# Seen on 2026-11-30:
#   materialxgltf 1.39.5, MaterialX 1.39.5
#   scale: base colour 4, 4; metallic-roughness 4, 4; normal none
#   factors 0.5 of base colour, roughness and normals, 0.25 of metallic: found none of 4
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check materialxgltf==1.39.5 MaterialX==1.39.5 pillow==13.0.0
venv/bin/python - <<'PY'
import contextlib, io, json
from importlib.metadata import version
from pathlib import Path

from materialxgltf.core import GLTF2MtlxOptions, GLTF2MtlxReader
from PIL import Image

names = ("colour", "rough", "normal")
for name, code in zip(names, ((255, 255, 255), (0, 255, 255), (128, 128, 255))):
    Image.new("RGB", (4, 4), code).save(f"{name}.png")


def texture(index, **more):
    return {"index": index, "extensions": {"KHR_texture_transform": {"scale": [4, 4]}}, **more}


surface = {"baseColorTexture": texture(0), "baseColorFactor": [0.5, 0.5, 0.5, 1.0],
           "metallicRoughnessTexture": texture(1), "roughnessFactor": 0.5, "metallicFactor": 0.25}
Path("tile.gltf").write_text(json.dumps({
    "asset": {"version": "2.0"}, "extensionsUsed": ["KHR_texture_transform"],
    "images": [{"uri": f"{name}.png"} for name in names], "textures": [{"source": at} for at in range(3)],
    "materials": [{"name": "tile", "pbrMetallicRoughness": surface, "normalTexture": texture(2, scale=0.5)}],
}))
reader = GLTF2MtlxReader()
reader.setOptions(GLTF2MtlxOptions())
with contextlib.redirect_stdout(io.StringIO()):
    document = reader.convert("tile.gltf")
nodes = [node for node in document.getNodes() if node.getInput("file")]
scales = {}
for node in nodes:
    scale = node.getInput("scale")
    scales[node.getInput("file").getValueString()] = scale.getValueString() if scale else "none"
values = [put.getValueString() for node in document.getNodes() for put in node.getInputs()]
found = sum(value.split(",")[0] in ("0.5", "0.25") for value in values)
print(f"materialxgltf {version('materialxgltf')}, MaterialX {version('MaterialX')}")
print(f"scale: base colour {scales['colour.png']}; metallic-roughness {scales['rough.png']}; "
      f"normal {scales['normal.png']}")
print(f"factors 0.5 of base colour, roughness and normals, 0.25 of metallic: found {found or 'none'} of 4")
assert list(scales.values()).count("4, 4") == 2 and scales["normal.png"] == "none" and not found, "changed"
PY
