"""Read exports of matcap by their sidecar, which states maps, units and encodings.

Of a .glb its textures are unpacked (glTF 2.0, section 4.4), as far as export/gltf.py writes them.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matcap.brdf.stated import SCALE
from matcap.errors import MatcapError
from matcap.files.names import name_fault, plain_name
from matcap.files.note import note
from matcap.files.udim import tile_names
from matcap.files.values import bounded, whole
from matcap.relight.foreign.names import NamedFile, Packing, SetFiles

_FORMAT, _VERSION = "matcap export", 2
# Beginnings of a texture's `meaning` in the sidecar, and the maps that it holds.
_MEANINGS: tuple[tuple[str, Packing], ...] = (
    ("diffuse albedo", {"base": "RGB"}),
    ("base colour", {"base": "RGB"}),
    ("specular albedo F0", {"specular": "RGB"}),
    ("F0, on the sRGB curve", {"specular": "RGB"}),
    ("RGB: F0, on the sRGB curve, A: smoothness", {"specular": "RGB", "gloss": "A"}),
    ("F0 / 0.08 of the dielectric", {"specular level": "R"}),
    ("perceptual roughness", {"roughness": "R"}),
    ("roughness", {"roughness": "R"}),
    ("metallic", {"metallic": "R"}),
    ("R: occlusion, G: roughness, B: metallic", {"roughness": "G", "metallic": "B"}),
    ("R: metallic, G: occlusion, B: detail, A: smoothness", {"metallic": "R", "gloss": "A"}),
    ("RGB: metallic, A: smoothness", {"metallic": "R", "gloss": "A"}),
    ("unit normal", {"normal": "RGB"}),
    ("height", {"height": "R"}),
)
_INSIDE = ("gltf",)  # targets whose textures are inside the document
# Targets whose shader uses base (1 - F0) where F0 is a texture of its own.
_CONSERVING = ("gltf", "unity-hdrp", "unity-urp", "usd")


def stated_export(folder: Path, place: Path) -> SetFiles | None:
    """Read the sidecar in a folder; None where there is none.

    Args:
        place: an empty folder for textures unpacked from a .glb.

    Raises:
        MatcapError: several exports, or a damaged sidecar.
    """
    sidecars = [(file, about) for file in sorted(folder.glob("*.json")) if (about := _read(file))]
    if not sidecars:
        return None
    if len(sidecars) > 1:
        raise MatcapError.at(
            folder,
            f"there are {len(sidecars)} exports in this folder",
            "keep one export in a folder",
        )
    file, about = sidecars[0]
    try:
        return _stated(folder, about, place)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OSError) as error:
        raise MatcapError.at(
            file,
            f"the export's description is damaged ({error})",
            "export the material again, or remove this file to go by the textures' names",
        ) from error


def _read(file: Path) -> dict[str, Any] | None:
    """A sidecar's JSON; None where a file is something else.

    Raises:
        MatcapError: a sidecar of another version.
    """
    try:
        about = json.loads(file.read_bytes())
    except (OSError, ValueError, RecursionError):
        note(f"{file}: not readable as JSON, so no export's units and names are taken from it")
        return None
    if not isinstance(about, dict) or about.get("format") != _FORMAT:
        return None
    if about.get("version") != _VERSION:
        raise MatcapError.at(
            file,
            f"export of version {about.get('version')}, this matcap reads {_VERSION}",
            "export it again with this matcap, or remove this file",
        )
    return about


def _stated(folder: Path, about: Mapping[str, Any], place: Path) -> SetFiles:
    unit = 1.0
    if about["unit"] == "mm":
        unit = bounded(about["provenance"][SCALE], f"'{SCALE}'", 1e-9, 1e9)
    named = [_named(folder, name, entry) for name, entry in about["files"].items()]
    f0 = None
    if about["target"] in _INSIDE:
        document = folder / plain_name(about["documents"][0])
        named, f0 = _unpacked(document, place)
    files: dict[str, NamedFile] = {}
    left_out = []
    # Prefer +Y normals to -Y ones, and the maps themselves to colours made for one shader.
    for one in sorted(named, key=lambda one: (one.style == "dx", one.rank)):
        taken = [kind for kind in one.channels if kind not in files]
        files |= {kind: one for kind in taken}
        if not taken:
            left_out.append(f"{one.path.name} (no map of its own)")
    code = about.get("height_code")
    height = None
    if "height" in files and code is not None:
        height = (
            bounded(code["scale"], "the height's scale", 0.0, 1e9) / unit,
            bounded(code["midlevel"], "the height's midlevel", -1e9, 1e9),
        )
    texel = bounded(about["texel"], "'texel'", 1e-9, 1e9) / unit
    target = str(about["target"]).removesuffix("-specular")  # the specular workflow of an engine
    conserving = target in _CONSERVING and "specular" in files
    grid = about["udim"]
    if grid is not None:
        columns, rows = grid
        grid = whole(columns, "'udim'", 1, 10), whole(rows, "'udim'", 1, 900)
    periodic = about["periodic"] is True
    return SetFiles(files, tuple(left_out), texel, height, conserving, grid, periodic, f0)


def _named(folder: Path, name: str, entry: Mapping[str, str]) -> NamedFile:
    meaning = entry["meaning"]
    wrong = name_fault(tile_names(name, None)[0])
    if wrong:
        raise ValueError(f"the file {name!r} {wrong}")
    fits = [
        packing
        for start, packing in _MEANINGS
        if meaning == start or meaning.startswith((f"{start},", f"{start} ", f"{start};"))
    ]
    channels = fits[0] if fits else {}
    style = "dx" if "-Y" in meaning or "+Y down" in meaning else "gl"
    rank = 0 if meaning.startswith(("diffuse albedo", "specular albedo")) else 1
    style = style if "normal" in channels else ""
    return NamedFile(folder / name, channels, style, rank, light=entry["colour_space"] == "linear")


_SUFFIX = {"image/png": ".png", "image/jpeg": ".jpg", "image/webp": ".webp"}
# Maps in an image, by the end of its name.
_PACKINGS: dict[str, Packing] = {
    "_base_color": {"base": "RGB"},
    "_specular_color": {"specular": "RGB"},
    "_roughness": {"roughness": "G", "metallic": "B"},
    "_normal": {"normal": "RGB"},
}


def _unpacked(file: Path, place: Path) -> tuple[list[NamedFile], float]:
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
