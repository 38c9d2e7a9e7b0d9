"""A glTF 2.0 binary (.glb): a textured plane.

- Specular workflow: KHR_materials_ior sets the largest F0 of the maps, the specular colour texture
  of KHR_materials_specular scales it per texel. Any F0 is kept.
- Metallic workflow: core glTF with one index of refraction.

The base colour compensates for the layer's darkening, F0 for the multiple scattering that viewers
add (workflows.py). Ambient occlusion is in red of the roughness and metallic texture. glTF has no
height map. Lengths are metres; a plane unit of unknown size is 1 m.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from matcap.export.job import ExportJob, MapRows, Picture, rgb
from matcap.export.options import Container, Depth
from matcap.export.presets import EngineModel, PackedMaterial, engine_surface, packed
from matcap.export.shading import GLTF, MadeSurface, Reader, TargetShading, TargetSurface
from matcap.export.texture_file import WRITERS, TextureFile
from matcap.export.textures import BASE, Export, coded_normal, occlusion_entry
from matcap.export.workflows import base_colour, brightest, clipping_notes, specular_colour
from matcap.files.names import MAKER

_LITERAL = TargetShading(layer="half")  # glTF's specification, which leaves that open
# Largest F0 by the index of refraction, which diverges at 1; a factor above 1 does the rest.
_LARGEST_F0 = 0.9
# Least F0 of the index. Blender uses the index's exact Fresnel, which at 0.3 is closest to
# Schlick's; lower ones reflect too much at grazing light (rust at 12 degrees: 6 % off, not 1 %).
_LEAST_F0 = 0.3
_FLOAT, _SHORT = 5126, 5123
_VERTICES, _INDICES = 34962, 34963
_REPEAT, _LINEAR, _MIPMAPS = 10497, 9729, 9987
_MIME: dict[Container, str] = {"png": "image/png", "jpg": "image/jpeg"}


def gltf_specular(job: ExportJob) -> Export:
    """NAME.glb in the specular workflow: colours in 8 bits, roughness and normals in 16.

    The residual is that of browsers, which read 8 bits.

    Raises:
        UsageError: a depth or format that glTF does not allow.
    """
    job.check_formats("glTF", tuple(_MIME), floats=False)
    largest = brightest(job, GLTF)
    limit = min(max(largest, _LEAST_F0), _LARGEST_F0)

    def tint(piece: MapRows) -> Picture:
        return rgb(specular_colour(piece, GLTF) / np.float32(largest))

    model = EngineModel(GLTF, "specular")

    def rough(piece: MapRows) -> Picture:
        return packed("occlusion", "roughness", "zero")(PackedMaterial(piece, model))

    textures = {
        "base_color": _stored(job, lambda p: base_colour(p, GLTF), "8", BASE, srgb=True),
        "specular_color": _stored(job, tint, "8", "F0", srgb=True),
        "roughness": _stored(job, rough, "16", "occlusion, roughness"),
        "normal": _stored(job, coded_normal, "16", "normal"),
    }

    def surface(seen: dict[str, TextureFile], read: Reader) -> TargetSurface:
        shown = _seen(model, seen, read)
        f0 = (shown.f0 * largest).clamp(max=1.0)
        return replace(shown, f0=f0, layer=f0)

    in_browsers = {kind: one.in_browsers() for kind, one in textures.items()}
    surfaces: dict[str, MadeSurface] = {
        "specular": partial(surface, in_browsers),
        "read with 16 bits": partial(surface, textures),
        "of a single bounce": lambda read: replace(surface(textures, read), shading=_LITERAL),
    }
    glb = partial(_glb, job, textures, ior(limit), largest / limit)
    notes = (*clipping_notes(job, GLTF), *job.size_notes())
    return Export({}, {f"{job.name}.glb": glb}, surfaces, notes, occlusion_entry(job))


def gltf_metallic(job: ExportJob) -> Export:
    """NAME.glb in the metallic workflow, for viewers without KHR_materials_specular.

    Raises:
        UsageError: a depth or format that glTF does not allow.
    """
    job.check_formats("glTF", tuple(_MIME), floats=False)
    start = EngineModel(GLTF, "metallic", even=_LARGEST_F0).of(job)
    model = start.nearest(job, lambda tried: partial(_seen, tried, _metallic_textures(job, tried)))
    textures = _metallic_textures(job, model)
    in_browsers = {kind: one.in_browsers() for kind, one in textures.items()}
    glb = partial(_glb, job, textures, ior(model.dielectric[0]), None)
    surfaces: dict[str, MadeSurface] = {"metallic": partial(_seen, model, in_browsers)}
    entries = occlusion_entry(job) | {"metallic": model.form}
    return Export({}, {f"{job.name}.glb": glb}, surfaces, job.size_notes(), entries)


def _metallic_textures(job: ExportJob, model: EngineModel) -> dict[str, TextureFile]:
    def rough(piece: MapRows) -> Picture:
        return packed("occlusion", "roughness", "metallic")(PackedMaterial(piece, model))

    return {
        "base_color": _stored(
            job, lambda p: PackedMaterial(p, model).metallic.base, "8", BASE, srgb=True
        ),
        "roughness": _stored(job, rough, "16", "occlusion, roughness, metallic"),
        "normal": _stored(job, coded_normal, "16", "normal"),
    }


def _seen(model: EngineModel, textures: dict[str, TextureFile], read: Reader) -> TargetSurface:
    """The reflectance that viewers render, of a specular colour as it is stored."""
    kinds = {
        "base_color": "base", "specular_color": "specular", "roughness": "orm",
        "normal": "normal_gl",
    }  # fmt: skip
    return engine_surface(model, {kinds[own]: one for own, one in textures.items()}, read)


def _stored(
    job: ExportJob, made: Callable[[MapRows], Picture], depth: Depth, meaning: str, **how: bool
) -> TextureFile:
    """A texture whose 16 bits stay accurate when browsers drop the lower 8."""
    return replace(TextureFile.of(job, made, depth, meaning, **how), eight_of_16=True)


def ior(f0: float) -> float:
    """Index of refraction of F0: (1 + sqrt(F0)) / (1 - sqrt(F0))."""
    return (1.0 + math.sqrt(f0)) / (1.0 - math.sqrt(f0))


def _glb(
    job: ExportJob, textures: dict[str, TextureFile], index: float, factor: float | None, _: Path
) -> bytes:
    """The file of textures by name.

    Args:
        index: of refraction.
        factor: on the specular colour; None in the metallic workflow.
    """
    binary = _Binary()
    # Untagged: glTF defines the colour space, and browsers would apply gAMA.
    with ThreadPoolExecutor(WRITERS) as pool:
        coded = pool.map(lambda one: one.encoded(job, tagged=False), textures.values())
        images = [
            {
                "bufferView": binary.view(data),
                "mimeType": _MIME[picture.container],
                "name": f"{job.name}_{kind}",
            }
            for (kind, picture), data in zip(textures.items(), coded, strict=True)
        ]
    texture = {kind: {"index": number} for number, kind in enumerate(textures)}
    extensions: dict[str, Any] = {"KHR_materials_ior": {"ior": index}}
    if factor is not None:
        extensions["KHR_materials_specular"] = {
            "specularColorFactor": [factor] * 3,
            "specularColorTexture": texture["specular_color"],
        }
    material = {
        "name": job.name,
        "pbrMetallicRoughness": {
            "baseColorTexture": texture["base_color"],
            "metallicRoughnessTexture": texture["roughness"],
            "metallicFactor": 1.0 if factor is None else 0.0,
            "roughnessFactor": 1.0,
        },
        "normalTexture": texture["normal"],
        "occlusionTexture": texture["roughness"],
        "extensions": extensions,
    }
    return binary.glb(_document(job, binary, material, images))


class _Binary:
    """Builds the binary chunk of a .glb."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._length = 0
        self.views: list[dict[str, Any]] = []

    def view(self, data: bytes, **extra: int) -> int:
        """Append bytes; returns the index of their buffer view."""
        self.views.append(
            {"buffer": 0, "byteOffset": self._length, "byteLength": len(data), **extra}
        )
        self._parts += [data, b"\0" * (-len(data) % 4)]
        self._length += len(data) + -len(data) % 4
        return len(self.views) - 1

    def glb(self, document: dict[str, Any]) -> bytes:
        """The file: header, JSON chunk, binary chunk (glTF 2.0, section 4.4)."""
        document["buffers"] = [{"byteLength": self._length}]
        document["bufferViews"] = self.views
        text = json.dumps(document, allow_nan=False, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        whole = 12 + 8 + len(text) + 8 + self._length
        header = struct.pack("<4sIII4s", b"glTF", 2, whole, len(text), b"JSON")
        return b"".join([header, text, struct.pack("<I4s", self._length, b"BIN\0"), *self._parts])


def _document(
    job: ExportJob, binary: _Binary, material: dict[str, Any], images: list[dict[str, Any]]
) -> dict[str, Any]:
    accessors, primitive = _plane(job, binary)
    return {
        "asset": {"version": "2.0", "generator": MAKER},
        "extensionsUsed": sorted(material["extensions"]),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": job.name}],
        "meshes": [{"name": job.name, "primitives": [primitive]}],
        "accessors": accessors,
        "materials": [material],
        "textures": [{"source": number, "sampler": 0} for number in range(len(images))],
        "images": images,
        "samplers": [
            {"magFilter": _LINEAR, "minFilter": _MIPMAPS, "wrapS": _REPEAT, "wrapT": _REPEAT}
        ],
    }


def _plane(job: ExportJob, binary: _Binary) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Accessors and the primitive of a quad around the origin, facing +z, y up."""
    x, y = (side * job.metres / 2.0 for side in job.extent)
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
