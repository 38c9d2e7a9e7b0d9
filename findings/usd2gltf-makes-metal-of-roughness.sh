#!/usr/bin/env bash
# usd2gltf takes one texture for metallic and roughness: what is rough becomes metal.
#
# Behaviour: UsdPreviewSurface has a texture each for metallic and roughness; glTF has one, with
# roughness in green and metallic in blue. usd2gltf refers to whichever comes last, unchanged, and
# leaves both factors at 1. Of grey maps (metallic 0, roughness 200 of 255) the glTF has metallic
# 200. A UsdTransform2d without a scale becomes a KHR_texture_transform of scale (0, 0), in which the
# whole texture is one texel, and its translation of 0 becomes 1.5: half a tile. No message is given.
# Why it matters: USDZ of captured materials has grey maps, one a property, and tiling or rotation
# in a UsdTransform2d. Leather arrives on the web as metal.
# Seen on 2026-12-01:
#   usd2gltf 0.3.5, usd-core 26.11
#   metallic 0 and roughness 200 in USD: texture rough.png for both, metallic 200 in glTF
#   rotation of 90 alone: scale [0, 0]; scale 4 and translation 0: offset [0.0, 1.5]
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check usd2gltf==0.3.5 usd-core==26.11 gltflib==1.0.13 pillow==13.0.0
venv/bin/python - <<'PY'
import json
from importlib.metadata import version
from pathlib import Path

from PIL import Image
from pxr import Gf, Sdf, Usd, UsdShade
from usd2gltf.converter import Converter

for name, code in (("metal", 0), ("rough", 200)):
    Image.new("RGB", (4, 4), (code,) * 3).save(f"{name}.png")
Path("out").mkdir()
TYPES = {"rotation": Sdf.ValueTypeNames.Float, "scale": Sdf.ValueTypeNames.Float2,
         "translation": Sdf.ValueTypeNames.Float2}


def converted(name, **transform):
    """The glTF of a material with a texture for metallic and one for roughness."""
    stage = Usd.Stage.CreateNew(f"{name}.usda")

    def shader(path, identifier):
        made = UsdShade.Shader.Define(stage, f"/leather{path}")
        made.CreateIdAttr(identifier)
        return made

    material = UsdShade.Material.Define(stage, "/leather")
    surface, coordinates = shader("/surface", "UsdPreviewSurface"), shader("/st", "UsdPrimvarReader_float2")
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    coordinates.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    if transform:
        moved = shader("/moved", "UsdTransform2d")
        moved.CreateInput("in", Sdf.ValueTypeNames.Float2).ConnectToSource(coordinates.ConnectableAPI(), "result")
        for key, value in transform.items():
            moved.CreateInput(key, TYPES[key]).Set(value)
        coordinates = moved
    for put, file in (("metallic", "metal"), ("roughness", "rough")):
        texture = shader(f"/{file}", "UsdUVTexture")
        texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(f"./{file}.png")
        texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(coordinates.ConnectableAPI(), "result")
        texture.CreateOutput("r", Sdf.ValueTypeNames.Float)
        surface.CreateInput(put, Sdf.ValueTypeNames.Float).ConnectToSource(texture.ConnectableAPI(), "r")
    Converter().process(stage, f"out/{name}.gltf")
    return json.loads(Path(f"out/{name}.gltf").read_text())


def texture_of(document):
    return document["materials"][0]["pbrMetallicRoughness"]["metallicRoughnessTexture"]


def transform_of(document):
    return texture_of(document)["extensions"]["KHR_texture_transform"]


plain = converted("plain")
image = plain["images"][plain["textures"][texture_of(plain)["index"]]["source"]]["uri"]
factor = plain["materials"][0]["pbrMetallicRoughness"].get("metallicFactor", 1.0)
metallic = round(factor * Image.open(f"out/{image}").getpixel((0, 0))[2])
turned = transform_of(converted("turned", rotation=90.0))["scale"]
tiled = transform_of(converted("tiled", scale=Gf.Vec2f(4, 4), translation=Gf.Vec2f(0, 0)))["offset"]
print(f"usd2gltf {version('usd2gltf')}, usd-core {version('usd-core')}")
print(f"metallic 0 and roughness 200 in USD: texture {image} for both, metallic {metallic} in glTF")
print(f"rotation of 90 alone: scale {turned}; scale 4 and translation 0: offset {tiled}")
assert metallic == 200 and turned == [0, 0] and tiled == [0, 1.5], "changed"
PY
