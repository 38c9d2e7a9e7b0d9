"""A map set as a folder: EXR pictures and one JSON document.

`<name>_diffuse.exr`, `_specular`, `_roughness` and `_normal` in half float, `_height` in 32-bit
float; `<name>.json` states what the numbers mean; 16-bit PNGs on request; of synthesised ones
`<name>_preview.png` (synth/pictures.py). Reading takes the EXR files and derives normals from the
height. If the normal file disagrees a note says so, and `--normals file` reads it instead
(edited.py).

Keys:
    format: "matcap map set".
    version: 1.
    matcap: version of the program that wrote it.
    name: beginning of the files' names.
    width: texels.
    height: texels.
    x: column of the left top texel in the endless field.
    y: row of the left top texel in the endless field, downwards.
    seed: realisation of the material, or null.
    periodic: whether the maps tile seamlessly.
    seam: step across the border over steps inside (brdf/edited.py), about 1 or less without a seam;
        absent where it was not measured.
    texel_size: a texel's side in plane units.
    height_scale: one unit of the EXR height, in plane units.
    normal: "gl" (+Y up) or "dx" (+Y down).
    specular_channels: 3 if F0 is coloured (red, green, blue); 1, or absent, if not.
    maps: for each map its `file` and `meaning`, and with PNGs `png` and `png_encoding`.
    png: with PNGs, `height_scale` and `height_midlevel`: height = (value - midlevel) * scale.
    conventions: axes, unit, reflectance and normals, in words.
    provenance: how the material was made. `millimetres_per_unit` is the length of a plane unit, or
        null if it was not measured; of the exemplar, `setup` is the photograph's camera and flash,
        as in the material file.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.edited import (
    COLOURS,
    as_saved,
    check_heights,
    in_rec709,
    note_other_normals,
    painted_normals,
    seam_ratio,
)
from matcap.brdf.stated import SPECULAR_CHANNELS, NormalSource, NormalStyle, stated_maps
from matcap.errors import MatcapError
from matcap.files.color import srgb_picture
from matcap.files.exr import read_exr, write_exr
from matcap.files.names import MAKER_VERSION, plain_name, read_document
from matcap.files.output import Output
from matcap.files.pixels import write_png

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet

FORMAT = "matcap map set"
PIECE = "_photo"  # suffix of the exemplar's map set, after the material's name
SETUP = "setup"  # in its provenance: camera and flash of the photograph
VERSION = 1  # of the document
# Largest size of all maps, in bytes a texel, to check free disk space.
EXR_BYTES = 2 * (3 + 3 + 1 + 3) + 4
PNG_BYTES = 2 * (3 + 3 + 1 + 1 + 3)

MEANINGS = {
    "diffuse": "diffuse albedo, linear Rec.709, D65",
    "specular": "specular albedo F0 of Schlick's Fresnel",
    "roughness": "perceptual roughness; GGX alpha is its square",
    "height": "height in plane units (half the photograph's long side)",
    "normal": "unit normal, each component in [-1, 1]",
}
PNG_ENCODINGS = {
    "diffuse": "sRGB",
    "specular": "linear",
    "roughness": "linear",
    "height": "linear; height = (value - midlevel) * scale",
    "normal": "linear; value = 0.5 + 0.5 n",
}
_CONVENTIONS = {
    "x": "right",
    "y": "up; row 0 is the top of the picture",
    "z": "towards the camera",
    "unit": "half the long side of the photograph",
    "reflectance": "diffuse/pi + D G F / (4 (n.l)(n.v)); GGX, height-correlated Smith, Schlick",
}


@dataclass(frozen=True)
class MapSetInfo:
    """Name and origin of a map set, for its JSON document."""

    name: str
    """Beginning of the files' names; a plain file name."""
    seed: int | None = None
    """Realisation of the material; None where there are no realisations."""
    origin: tuple[int, int] = (0, 0)
    """(column, row) of the left top texel in the material's endless field."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """How the material was made; any JSON."""


def write_mapset(
    maps: MapSet,
    folder: str | Path,
    info: MapSetInfo,
    *,
    png: bool = False,
    normal: NormalStyle = "gl",
) -> Path:
    """Write a map set into a folder, all files or none; returns the JSON document's path.

    Replaces a set of the same name, PNGs included.

    Args:
        maps: without batch dimensions.
        folder: created if missing.
        info: name, seed, origin and provenance.
        png: also write 16-bit PNGs.
        normal: "gl" for +Y up (OpenGL), "dx" for +Y down (DirectX).

    Raises:
        UsageError: a name that is no plain file name.
        MatcapError: values that are not finite, a full disk, an unwritable folder.
    """
    folder, name = Path(folder), plain_name(info.name)
    arrays = _arrays(maps, normal)
    coloured = maps.specular.shape[-3]
    document = mapset_document(
        info, maps.size, maps.texel_size, periodic=maps.periodic, normal=normal, specular=coloured
    )
    document["seam"] = round(seam_ratio(maps), 3)
    with Output(folder, [*mapset_files(name), preview_name(name)]).stage() as stage:
        for kind, pixels in arrays.items():
            file = f"{name}_{kind}.exr"
            write_exr(stage / file, pixels, half=kind != "height")
            document["maps"][kind] = {"file": file, "meaning": meaning_of(kind, coloured)}
        if png:
            heights = arrays["height"]
            scale, midlevel = height_range(float(heights.min()), float(heights.max()))
            document["png"] = {"height_scale": scale, "height_midlevel": midlevel}
            for kind, pixels in arrays.items():
                file = f"{name}_{kind}.png"
                write_png(stage / file, coded(kind, pixels, scale, midlevel), bits=16)
                document["maps"][kind] |= {"png": file, "png_encoding": PNG_ENCODINGS[kind]}
        text = json.dumps(document, indent=2, allow_nan=False, default=str)
        (stage / f"{name}.json").write_text(text + "\n")
    return folder / f"{name}.json"


def read_mapset(
    path: str | Path, normals: NormalSource = "height"
) -> tuple[MapSet, dict[str, Any]]:
    """Read a map set: (maps as float32 on the CPU, the JSON document).

    Args:
        path: the JSON document, or a folder with exactly one set.
        normals: "height" derives them; "file" reads the normal map, which may have been edited.

    Raises:
        MatcapError: no set or several in the folder; a map that is missing, corrupt, or of another
            size or number of channels.
    """
    import torch

    from matcap.brdf.maps import CHANNELS, MapSet

    file = _find_document(Path(path))
    document = _load_document(file)
    if document is None:
        raise MatcapError.at(
            file,
            "this is not the JSON file of a map set",
            "give the folder that matcap synth or matcap capture wrote",
        )
    stated = stated_maps(document, CHANNELS, file)
    maps = {}
    for kind, channels in stated.channels.items():
        name, named = stated.files[kind]
        picture = read_exr(file.parent / name, size=stated.size, channels=named)
        pixels = as_saved(picture, channels, str(file.parent / name))
        if pixels.shape[2] != channels:
            raise MatcapError.at(
                file.parent / name,
                f"has {pixels.shape[2]} channels instead of {channels}",
                _recount(kind, pixels.shape[2]),
            )
        if kind in COLOURS and channels == 3:
            pixels = in_rec709(pixels, picture.primaries, str(file.parent / name))
        if kind == "height":
            if stated.height_scale != 1.0:
                pixels = pixels * np.float32(stated.height_scale)
            check_heights(pixels, str(file.parent / name))
        maps[kind] = torch.from_numpy(pixels).movedim(-1, 0).contiguous()
    document |= {"name": stated.name, "provenance": stated.provenance}
    whole = MapSet(**maps, texel_size=stated.texel_size, periodic=stated.periodic)
    if normals == "file":
        painted = painted_normals(document, file.parent, stated.size)
        return replace(whole, painted=painted), document
    note_other_normals(whole, document, file.parent)
    return whole, document


def _recount(kind: str, count: int) -> str:
    """The remedy for a map with another number of channels."""
    if kind == "specular" and count in (1, 3):
        return f'save it as it was, or set "{SPECULAR_CHANNELS}": {count} in the JSON file'
    return "write the map set again"


def mapset_files(name: str) -> list[str]:
    """Names of all files that write_mapset may write."""
    maps = [f"{name}_{kind}.{suffix}" for kind in MEANINGS for suffix in ("exr", "png")]
    return [*maps, f"{name}.json"]


def preview_name(name: str) -> str:
    """File name of a map set's preview."""
    return f"{name}_preview.png"


def mapset_bytes(width: int, height: int, *, png: bool) -> int:
    """Upper bound of the disk space of a map set, in bytes."""
    return width * height * (EXR_BYTES + (PNG_BYTES if png else 0)) + 1_000_000


def find_mapsets(folder: Path) -> list[Path]:
    """The JSON documents of the map sets in a folder, sorted.

    Without an exemplar's set (NAME_photo) where its material's own (NAME) is there.
    """
    documents = [file for file in sorted(folder.glob("*.json")) if _load_document(file) is not None]
    names = {file.stem for file in documents}
    return [file for file in documents if file.stem.removesuffix(PIECE) not in names - {file.stem}]


def _arrays(maps: MapSet, normal: NormalStyle) -> dict[str, NDArray[np.float32]]:
    """Pictures of all maps for the files: (H, W, 3) or (H, W) float32."""
    from matcap.brdf.maps import MAP_NAMES

    if maps.height.ndim != 3:
        raise ValueError("maps with batch dimensions cannot be written: pass one map set")
    arrays = {}
    for kind in MAP_NAMES:
        tensor = getattr(maps, kind).detach().cpu().float()
        arrays[kind] = tensor.movedim(0, -1).squeeze(-1).numpy()
    check_heights(arrays["height"], "height")
    if normal == "dx":
        arrays["normal"] = arrays["normal"] * np.array([1.0, -1.0, 1.0], dtype=np.float32)
    return arrays


def mapset_document(
    info: MapSetInfo,
    size: tuple[int, int],
    texel_size: float,
    *,
    periodic: bool,
    normal: NormalStyle,
    specular: int = 1,
) -> dict[str, Any]:
    """The JSON document of a map set, with `maps` empty; `specular` is F0's channel count."""
    width, height = size
    up = "up (OpenGL)" if normal == "gl" else "down (DirectX)"
    return {
        "format": FORMAT,
        "version": VERSION,
        "matcap": MAKER_VERSION,
        "name": info.name,
        "width": width,
        "height": height,
        "x": info.origin[0],
        "y": info.origin[1],
        "seed": info.seed,
        "periodic": periodic,
        "texel_size": texel_size,
        "height_scale": 1.0,
        "normal": normal,
        **({} if specular == 1 else {SPECULAR_CHANNELS: specular}),
        "maps": {},
        "conventions": _CONVENTIONS | {"normal": f"+Y {up}"},
        "provenance": info.provenance,
    }


def meaning_of(kind: str, specular: int) -> str:
    """Meaning of a map's numbers, in words; `specular` is F0's channel count."""
    coloured = kind == "specular" and specular > 1
    return MEANINGS[kind] + (", linear Rec.709, D65" if coloured else "")


def height_range(low: float, high: float) -> tuple[float, float]:
    """(scale, midlevel) of heights from low to high: (value - midlevel) scale, values in [0, 1]."""
    if high > low:
        return high - low, -low / (high - low)
    return 1.0, 0.5 - low


def coded(
    kind: str, pixels: NDArray[np.float32], scale: float, midlevel: float
) -> NDArray[np.float32]:
    """Code values of a map in a PNG, [0, 1]; scale and midlevel as height_range returns them."""
    if kind == "diffuse":
        return srgb_picture(pixels)
    if kind == "normal":
        return 0.5 + 0.5 * pixels
    if kind == "height":
        return pixels / scale + midlevel
    return pixels


def _find_document(path: Path) -> Path:
    if path.is_file():
        return path
    if not path.is_dir():
        what = "no such file or folder" if not path.exists() else "is no regular file"
        raise MatcapError.at(path, what, "check the path")
    documents = find_mapsets(path)
    if not documents:
        raise MatcapError.at(
            path,
            "there is no map set in this folder",
            "give a folder that matcap synth or matcap capture wrote",
        )
    if len(documents) > 1:
        names = ", ".join(file.name for file in documents)
        raise MatcapError.at(
            path,
            f"there are {len(documents)} map sets in this folder ({names})",
            "name the JSON file of one of them",
        )
    return documents[0]


def _load_document(file: Path) -> dict[str, Any] | None:
    """A map set's JSON document; None for any other file.

    Raises:
        MatcapError: a map set of another version.
    """
    document = read_document(file, FORMAT)
    if document is not None and document.get("version") != VERSION:
        raise MatcapError.at(
            file,
            f"map set of version {document.get('version')}, this matcap reads {VERSION}",
            "update matcap",
        )
    return document
