"""glTF binaries by a reader of their own, and through Khronos's validator."""

import json
import shutil
import struct
import subprocess
from pathlib import Path

import cv2
import numpy as np
import torch
from exported import channels, linear

from matcap.export.shading import TargetShading, TargetSurface

VALIDATOR = Path(__file__).parents[2] / ".node" / "node_modules" / "gltf-validator"

_VALIDATE = """
const [place, file] = process.argv.slice(1);
const bytes = new Uint8Array(require('fs').readFileSync(file));
require(place).validateBytes(bytes).then(found => console.log(JSON.stringify(found.issues)));
"""


def has_validator() -> bool:
    """Whether node and `npm install --prefix .node gltf-validator` are there."""
    return shutil.which("node") is not None and VALIDATOR.is_dir()


def complaints(path) -> list[str]:
    """Errors and warnings of Khronos's validator."""
    command = ["node", "-e", _VALIDATE, str(VALIDATOR), str(path)]
    said = subprocess.run(command, capture_output=True, text=True, check=True)
    return [one["message"] for one in json.loads(said.stdout)["messages"] if one["severity"] < 2]


def opened(path):
    """(JSON document, function from a buffer view's number to its bytes)."""
    content = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", content)
    assert (magic, version, length) == (b"glTF", 2, len(content))
    size, kind = struct.unpack_from("<I4s", content, 12)
    assert (kind, size % 4) == (b"JSON", 0)
    document = json.loads(content[20 : 20 + size])
    start = 28 + size
    rest, kind = struct.unpack_from("<I4s", content, 20 + size)
    assert (kind, rest % 4, start + rest) == (b"BIN\0", 0, len(content))
    assert document["buffers"] == [{"byteLength": rest}]

    def view(number):
        one = document["bufferViews"][number]
        assert one["byteOffset"] % 4 == 0
        return content[start + one["byteOffset"] :][: one["byteLength"]]

    return document, view


def surface(path, *, compensated=False, browsers=False) -> TargetSurface:
    """As the specification and its extensions specular and ior say, and no other way.

    Args:
        path: of the .glb.
        compensated: with what bounces between microfacets, as most viewers have it.
        browsers: the lower byte of 16 bits is dropped.
    """
    document, view = opened(path)
    (material,) = document["materials"]
    assert set(document["extensionsUsed"]) == set(material["extensions"])

    def read(texture):
        image = document["images"][document["textures"][texture["index"]]["source"]]
        raw = np.frombuffer(view(image["bufferView"]), dtype=np.uint8)
        stored = cv2.imdecode(raw, cv2.IMREAD_UNCHANGED)
        if browsers and stored.dtype == np.uint16:
            stored = (stored >> 8).astype(np.uint8)
        return stored[..., ::-1] / np.float64(np.iinfo(stored.dtype).max)

    rough = material["pbrMetallicRoughness"]
    assert (rough["metallicFactor"], rough["roughnessFactor"]) == (0.0, 1.0)
    ior = material["extensions"]["KHR_materials_ior"]["ior"]
    tint = material["extensions"]["KHR_materials_specular"]
    factor = torch.tensor(tint["specularColorFactor"], dtype=torch.float64)[:, None, None]
    colour = channels(linear(read(tint["specularColorTexture"])))
    f0 = (((ior - 1.0) / (ior + 1.0)) ** 2 * factor * colour).clamp(max=1.0)
    return TargetSurface(
        channels(linear(read(rough["baseColorTexture"]))),
        f0,
        channels(read(rough["metallicRoughnessTexture"]))[1:2],
        2.0 * channels(read(material["normalTexture"])) - 1.0,
        layer=f0.amax(dim=0, keepdim=True),
        shading=TargetShading(layer="half", compensated=compensated),
    )
