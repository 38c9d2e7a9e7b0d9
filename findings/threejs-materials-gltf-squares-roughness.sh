#!/usr/bin/env bash
# threejs-materials saves glTF whose one roughness is squared where metalness has a map, and the reverse.
#
# Behaviour: PbrProperties.save_gltf and to_gltf pack a metalness map and the constant roughness into one
# texture, and write the constant as roughnessFactor too; glTF multiplies both. A roughness of 0.4 with a
# metalness map is 0.16, a metalness of 0.5 with a roughness map 0.25. Without a map, or with two, values
# are kept. texture_average_color averages sRGB codes and decodes the mean: half black, half white is 0.21.
# Why it matters: a satin metal is nearly a mirror in the saved file, and is right in three.js itself.
# Seen on 2026-12-01:
#   threejs-materials 1.2.5
#   metalness map, roughness 0.4: roughness 0.160, metalness 1.000
#   roughness map 0.502, metalness 0.5: roughness 0.502, metalness 0.251
#   no map, roughness 0.4, metalness 0.5: roughness 0.400, metalness 0.500
#   mean of half black, half white, linear: 0.216
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check --no-compile threejs-materials==1.2.5 pygltflib==1.16.5 pillow==13.0.0 numpy==2.4.6
venv/bin/python -W ignore - <<'PY'
import base64
import io
from importlib.metadata import version

import numpy as np
from PIL import Image
from threejs_materials import PbrProperties, texture_average_color

Image.fromarray(np.full((8, 8), 255, np.uint8)).save("metalness.png")
Image.fromarray(np.full((8, 8), 128, np.uint8)).save("roughness.png")


def rendered(**properties):
    """Roughness and metalness by glTF: each factor times its channel of the texture."""
    gltf = PbrProperties.create("metal", **properties).to_gltf()
    pbr = gltf.materials[0].pbrMetallicRoughness
    channels = np.ones(3)
    if pbr.metallicRoughnessTexture:
        image = gltf.images[gltf.textures[pbr.metallicRoughnessTexture.index].source]
        data = base64.b64decode(image.uri.split(",", 1)[1])
        channels = np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))[0, 0] / 255
    return pbr.roughnessFactor * channels[1], pbr.metallicFactor * channels[2]


by_metalness = rendered(metalness=1.0, roughness=0.4, metalness_map="metalness.png")
by_roughness = rendered(metalness=0.5, roughness=1.0, roughness_map="roughness.png")
plain = rendered(metalness=0.5, roughness=0.4)
halves = io.BytesIO()
Image.fromarray(np.repeat([[[0] * 3], [[255] * 3]], 8, axis=0).astype(np.uint8)).save(halves, "PNG")
mean = texture_average_color(halves.getvalue())[0]

print("threejs-materials", version("threejs-materials"))
print("metalness map, roughness 0.4: roughness {:.3f}, metalness {:.3f}".format(*by_metalness))
print("roughness map 0.502, metalness 0.5: roughness {:.3f}, metalness {:.3f}".format(*by_roughness))
print("no map, roughness 0.4, metalness 0.5: roughness {:.3f}, metalness {:.3f}".format(*plain))
print(f"mean of half black, half white, linear: {mean:.3f}")
assert np.allclose(by_metalness, (0.16, 1), atol=0.01) and np.allclose(by_roughness, (0.502, 0.25), atol=0.01), "changed"
assert np.allclose(plain, (0.4, 0.5)) and abs(mean - 0.214) < 0.01, "changed"
PY
