"""A glTF 2.0 binary: a textured plane with KHR_materials_specular and KHR_materials_ior.

The index of refraction gives the largest F0 of the maps, the specular colour texture scales it
down per texel; so F0 is kept, whatever it is. The base colour is compensated (see
specular_workflow.py). The height has no place in glTF; its scale goes with the sidecar. One metre
is one metre where a plane unit's length is known, otherwise one plane unit.
"""

from __future__ import annotations

import json
import math
import struct
from typing import Any

import numpy as np

from matcap.errors import UsageError
from matcap.export.specular_workflow import base_colour
from matcap.export.surface import TargetSurface
from matcap.export.texture_file import Stored
from matcap.export.textures import Export, ExportJob, coded_normal, seen, seen_normal
from matcap.files.maker import MAKER

# Beyond this F0 the index of refraction runs off to infinity; a factor above 1 does the rest.
_LARGEST_F0 = 0.9
_FLOAT, _SHORT = 5126, 5123
_VERTICES, _INDICES = 34962, 34963
_REPEAT, _LINEAR, _MIPMAPS = 10497, 9729, 9987


def gltf(job: ExportJob) -> Export:
    """NAME.glb, everything inside: colours of 8 bits, roughness and normals of 16.

    Raises:
        UsageError: textures of floats were asked for.
    """
    if job.depth in ("half", "float"):
        raise UsageError("glTF knows no textures of floats", where="--bits", remedy="give 8 or 16")
    colour, fine = job.depth_or("8"), job.depth_or("16")
    specular = job.picture("specular")
    largest = max(float(specular.max()), 1e-4)
    limit = min(largest, _LARGEST_F0)
    base, notes = base_colour(job)
    roughness = job.picture("roughness")
    ones = np.ones_like(roughness)
    tint = Stored(np.repeat((specular / largest)[..., None], 3, axis=2), colour, srgb=True)
    pictures = {
        "base_color": Stored(base, colour, srgb=True),
        "specular_color": tint,
        "roughness": Stored(np.stack([ones, roughness, 0.0 * ones], axis=-1), fine),
        "normal": Stored(coded_normal(job), fine),
    }
    ior = (1.0 + math.sqrt(limit)) / (1.0 - math.sqrt(limit))
    f0 = (seen(tint)[:1] * largest).clamp(max=1.0)
    surface = TargetSurface(
        seen(pictures["base_color"]),
        f0,
        seen(pictures["roughness"])[1:2],
        seen_normal(pictures["normal"]),
        layer=f0,
    )
    binary = _Binary()
    document = _document(job, binary, pictures, ior, largest / limit)
    glb = binary.glb(document)
    return Export({}, {f"{job.name}.glb": glb}, surface, notes)


class _Binary:
    """The binary chunk of a .glb, grown piece by piece."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self.views: list[dict[str, Any]] = []

    def view(self, data: bytes, **extra: int) -> int:
        """Add bytes; gives their buffer view's number."""
        self._bytes += b"\0" * (-len(self._bytes) % 4)
        self.views.append(
            {"buffer": 0, "byteOffset": len(self._bytes), "byteLength": len(data), **extra}
        )
        self._bytes += data
        return len(self.views) - 1

    def glb(self, document: dict[str, Any]) -> bytes:
        """The file: header, JSON chunk, binary chunk (glTF 2.0, section 4.4)."""
        self._bytes += b"\0" * (-len(self._bytes) % 4)
        document["buffers"] = [{"byteLength": len(self._bytes)}]
        document["bufferViews"] = self.views
        text = json.dumps(document, allow_nan=False, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(self._bytes), b"BIN\0") + self._bytes
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _document(
    job: ExportJob, binary: _Binary, pictures: dict[str, Stored], ior: float, factor: float
) -> dict[str, Any]:
    metres = 1.0 if job.millimetres is None else job.millimetres / 1000.0
    images = [
        {
            "bufferView": binary.view(picture.png()),
            "mimeType": "image/png",
            "name": f"{job.name}_{kind}",
        }
        for kind, picture in pictures.items()
    ]
    texture = {kind: {"index": index} for index, kind in enumerate(pictures)}
    extensions = {
        "KHR_materials_ior": {"ior": ior},
        "KHR_materials_specular": {
            "specularColorFactor": [factor] * 3,
            "specularColorTexture": texture["specular_color"],
        },
    }
    accessors, primitive = _plane(job, binary, metres)
    return {
        "asset": {"version": "2.0", "generator": MAKER},
        "extensionsUsed": sorted(extensions),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": job.name}],
        "meshes": [{"name": job.name, "primitives": [primitive]}],
        "accessors": accessors,
        "materials": [
            {
                "name": job.name,
                "pbrMetallicRoughness": {
                    "baseColorTexture": texture["base_color"],
                    "metallicRoughnessTexture": texture["roughness"],
                    "metallicFactor": 0.0,
                    "roughnessFactor": 1.0,
                },
                "normalTexture": texture["normal"],
                "extensions": extensions,
            }
        ],
        "textures": [{"source": index, "sampler": 0} for index in range(len(images))],
        "images": images,
        "samplers": [
            {"magFilter": _LINEAR, "minFilter": _MIPMAPS, "wrapS": _REPEAT, "wrapT": _REPEAT}
        ],
    }


def _plane(
    job: ExportJob, binary: _Binary, metres: float
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Accessors and the primitive of a quad around the origin, facing +z, y up."""
    x, y = (side * metres / 2.0 for side in job.extent)
    corners = [(-x, -y, 0.0), (x, -y, 0.0), (x, y, 0.0), (-x, y, 0.0)]
    attributes = {
        "POSITION": ("VEC3", corners),
        "NORMAL": ("VEC3", [(0.0, 0.0, 1.0)] * 4),
        # Green points up: the bitangent is normal x tangent, times w.
        "TANGENT": ("VEC4", [(1.0, 0.0, 0.0, 1.0)] * 4),
        "TEXCOORD_0": ("VEC2", [(0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0)]),
    }
    accessors: list[dict[str, Any]] = []
    for name, (kind, values) in attributes.items():
        array = np.array(values, dtype="<f4")
        accessor: dict[str, Any] = {
            "bufferView": binary.view(array.tobytes(), target=_VERTICES),
            "componentType": _FLOAT,
            "count": len(array),
            "type": kind,
        }
        if name == "POSITION":
            accessor |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        accessors.append(accessor)
    faces = np.array([0, 1, 2, 0, 2, 3], dtype="<u2").tobytes()
    accessors.append(
        {
            "bufferView": binary.view(faces, target=_INDICES),
            "componentType": _SHORT,
            "count": 6,
            "type": "SCALAR",
        }
    )
    numbers = {name: index for index, name in enumerate(attributes)}
    return accessors, {"attributes": numbers, "indices": len(attributes), "material": 0}
