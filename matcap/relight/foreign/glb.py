"""Unpack the textures of a .glb that `matcap export` wrote (glTF 2.0, section 4.4).

Reads only what export/gltf.py writes; for other programs' files use any glTF tool.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

from matcap.files.values import bounded
from matcap.relight.foreign.names import NamedFile, Packing

_SUFFIX = {"image/png": ".png", "image/jpeg": ".jpg", "image/webp": ".webp"}
# Maps in an image, by the end of its name.
_PACKINGS: dict[str, Packing] = {
    "_base_color": {"base": "RGB"},
    "_specular_color": {"specular": "RGB"},
    "_roughness": {"roughness": "G", "metallic": "B"},
    "_normal": {"normal": "RGB"},
}


def unpacked(file: Path, place: Path) -> tuple[list[NamedFile], float]:
    """Write the textures into a folder; returns them, and F0 = ((ior - 1) / (ior + 1))^2 factor.

    That is F0 where specular colour is 1, or of dielectrics without a specular texture.

    Raises:
        ValueError, KeyError, TypeError, IndexError: the file is damaged, or not matcap's.
        OSError: it cannot be read.
    """
    data = file.read_bytes()
    magic, _, _, length, kind = struct.unpack_from("<4sIII4s", data.ljust(20, b"\0"))
    if (magic, kind) != (b"glTF", b"JSON") or 28 + length > len(data):
        raise ValueError(f"{file.name} is no glTF binary")
    document: dict[str, Any] = json.loads(data[20 : 20 + length])
    content = data[28 + length :]
    textures = []
    for image in document["images"]:
        view = document["bufferViews"][image["bufferView"]]
        start, size = int(view.get("byteOffset", 0)), int(view["byteLength"])
        ends = [end for end in _PACKINGS if str(image["name"]).endswith(end)]
        if start < 0 or size <= 0 or start + size > len(content):
            raise ValueError(f"an image lies outside of {file.name}")
        if ends:
            target = place / f"{file.stem}{ends[0]}{_SUFFIX[image['mimeType']]}"
            target.write_bytes(content[start : start + size])
            style = "gl" if ends[0] == "_normal" else ""
            textures.append(NamedFile(target, _PACKINGS[ends[0]], style))
    extensions = document["materials"][0]["extensions"]
    index = bounded(extensions["KHR_materials_ior"]["ior"], "ior", 1.0, 1e6)
    factor = extensions.get("KHR_materials_specular", {}).get("specularColorFactor", [1.0])[0]
    f0 = ((index - 1.0) / (index + 1.0)) ** 2 * bounded(factor, "specularColorFactor", 0.0, 1e3)
    return textures, f0
