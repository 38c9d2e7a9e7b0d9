#!/usr/bin/env bash
# trimesh rounds glTF's linear base colour factor to 8 bits and drops ior and specular.
#
# Behaviour: load() stores baseColorFactor, which glTF defines in linear light, as uint8 and export()
# writes it back so; KHR_materials_ior and KHR_materials_specular vanish, without a warning.
# Why it matters: trimesh is the usual way to put a captured material on another mesh. Linear light
# in 8 bits has 12 levels below 0.05: charcoal of 0.002 becomes 0.0039. Without the
# extensions every renderer assumes F0 = 0.04, whatever the material has: here 0.082 is lost.
# Seen on 2026-11-29:
#   trimesh 5.2.0
#   base colour [0.018, 0.002, 0.04] becomes [0.0196, 0.0039, 0.0392]
#   extensions ['KHR_materials_ior', 'KHR_materials_specular'] become []
set -euo pipefail
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check trimesh==5.2.0 numpy==2.4.6
venv/bin/python - <<'PY'
import io, json, struct
import numpy as np, trimesh

def document(data):
    length = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + length]), data[20 + length :]

def glb(about, rest):
    text = json.dumps(about).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + rest
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body

box = trimesh.creation.box()
material = trimesh.visual.material.PBRMaterial(baseColorFactor=[1.0, 1.0, 1.0, 1.0])
box.visual = trimesh.visual.TextureVisuals(uv=np.zeros((len(box.vertices), 2)), material=material)
about, rest = document(box.export(file_type="glb"))
stated = [0.018, 0.002, 0.04]
about["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = [*stated, 1.0]
about["materials"][0]["extensions"] = {
    "KHR_materials_ior": {"ior": 1.8}, "KHR_materials_specular": {"specularColorFactor": [1, 1, 1]}
}
about["extensionsUsed"] = ["KHR_materials_ior", "KHR_materials_specular"]
scene = trimesh.load(io.BytesIO(glb(about, rest)), file_type="glb")
back, _ = document(scene.export(file_type="glb"))
found = back["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"][:3]
kept = sorted(back["materials"][0].get("extensions", {}))
print("trimesh", trimesh.__version__)
print(f"base colour {stated} becomes [{', '.join(f'{value:.4f}' for value in found)}]")
print(f"extensions {about['extensionsUsed']} become {kept}")
assert kept == [] and abs(found[1] - 1 / 255) < 1e-6, "the behaviour has changed"
PY
