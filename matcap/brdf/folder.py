"""A map set as a folder of pictures with one JSON file.

`<name>_diffuse.exr`, `_specular`, `_roughness` and `_normal` in half float, `_height` in 32-bit
float, and `<name>.json`, which says what the numbers mean. On request also 16-bit PNGs. The folder
is read back from the EXR files; the normal is derived from the height again. Where the file says
something else, a note says so, and `--normals file` reads it (other_normals.py).

Keys:
    format: "matcap map set".
    version: 1.
    matcap: version of the program that wrote it.
    name: what the files are called.
    width: texels.
    height: texels.
    x: of the left top texel in the endless field.
    y: of the left top texel in the endless field, downwards.
    seed: realisation of the material, or null.
    periodic: whether the right border continues at the left one, and the bottom at the top.
    seam: where it was measured, step across the border over steps inside (brdf/seam.py): about 1
        or less without a seam.
    texel_size: a texel's side in plane units.
    height_scale: what one unit of the EXR height is, in plane units.
    normal: "gl" (+Y up) or "dx" (+Y down).
    specular_channels: 3 where F0 has a colour: red, green, blue; 1, or absent, where it has none.
    maps: for each map its `file` and `meaning`, and with PNGs `png` and `png_encoding`.
    png: with PNGs, `height_scale` and `height_midlevel`: height = (value - midlevel) * scale.
    conventions: what axes, unit, reflectance and normals are, in words.
    provenance: how the material was made; its `millimetres_per_unit` is how long a plane unit is,
        or null where it was not measured; of the photographed piece, `setup` is its camera and
        flash, as in the material file.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.edited import COLOURS, as_saved, in_rec709
from matcap.brdf.heights import check_heights
from matcap.brdf.other_normals import note_other_normals, painted_normals
from matcap.brdf.seam import seam_ratio
from matcap.brdf.stated import SPECULAR_CHANNELS, NormalSource, NormalStyle, stated_maps
from matcap.errors import MatcapError
from matcap.files.exr import read_exr_named, write_exr
from matcap.files.maker import MAKER_VERSION
from matcap.files.names import plain_name
from matcap.files.png import write_png
from matcap.files.publish import recover
from matcap.files.srgb import srgb_picture
from matcap.files.staging import staged

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet

# Entries of a document that identify a map set among others of the same name.
_WHAT_IT_IS = (
    "format", "width", "height", "x", "y", "seed", "periodic", "period", "udim", "normal",
    "texel_size", SPECULAR_CHANNELS, "provenance",
)  # fmt: skip

FORMAT = "matcap map set"
PIECE = "_photo"  # after a material's name: the maps of the photographed piece itself
SETUP = "setup"  # in its provenance: camera and flash of the photograph
VERSION = 1  # of the document
# Bytes a texel takes at most, for all maps: what is asked of the disk beforehand.
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
    """Where a map set comes from: what its JSON file says in addition to sizes and conventions.

    Attributes:
        name: what the files are called; a plain file name.
        seed: the realisation of the material, or None when there is no such thing.
        origin: (x, y) of the left top texel in the material's endless field.
        provenance: how the material was made; any JSON.
    """

    name: str
    seed: int | None = None
    origin: tuple[int, int] = (0, 0)
    provenance: dict[str, Any] = field(default_factory=dict)


def write_mapset(
    maps: MapSet,
    folder: str | Path,
    info: MapSetInfo,
    *,
    png: bool = False,
    normal: NormalStyle = "gl",
) -> Path:
    """Write a map set into a folder, all of its files or none; returns the JSON file's path.

    A set of the same name is replaced, PNGs included.

    Args:
        maps: one map set without batch dimensions.
        folder: made when missing.
        info: name, seed, origin and provenance.
        png: write 16-bit PNGs beside the EXR files.
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
    with staged(folder, replacing=mapset_files(name)) as stage:
        for kind, pixels in arrays.items():
            file = f"{name}_{kind}.exr"
            write_exr(stage / file, pixels, half=kind != "height")
            document["maps"][kind] = {"file": file, "meaning": meaning_of(kind, coloured)}
        if png:
            scale, midlevel = height_range(arrays["height"])
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
    """Read a map set back: (maps as float32 on the CPU, the JSON document).

    Args:
        path: the set's JSON file, or a folder that holds exactly one set.
        normals: derived from the "height", or read from their "file", where somebody painted.

    Raises:
        MatcapError: no set or several in the folder, a missing, corrupt or misfitting map.
    """
    import torch

    from matcap.brdf.maps import CHANNELS, MapSet

    file = _find_document(Path(path))
    document = _load_document(file)
    if document is None:
        raise MatcapError(
            "this is not the JSON file of a map set",
            where=str(file),
            remedy="give the folder that matcap synth or matcap capture wrote",
        )
    stated = stated_maps(document, CHANNELS, file)
    maps = {}
    for kind, channels in stated.channels.items():
        name, named = stated.files[kind]
        picture = read_exr_named(file.parent / name, size=stated.size, channels=named)
        pixels = as_saved(picture, channels, str(file.parent / name))
        if pixels.shape[2] != channels:
            raise MatcapError(
                f"has {pixels.shape[2]} channels instead of {channels}",
                where=str(file.parent / name),
                remedy=_recount(kind, pixels.shape[2]),
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
    """What to do about a map of another number of channels: an editor may have added a colour."""
    if kind == "specular" and count in (1, 3):
        return f'save it as it was, or say "{SPECULAR_CHANNELS}": {count} in the JSON file'
    return "write the map set again"


def refuse_to_replace(folder: Path, new: dict[str, Any], names: Iterable[str]) -> None:
    """Refuse to put a map set where another one of its name stands; the same one may come again.

    Args:
        folder: where it is to be written.
        new: its document, with or without what PNGs add.
        names: of all files that it may have.

    Raises:
        MatcapError: there is a set of that name that differs, with what it differs in; or a file
            that belongs to no set.
    """
    old = _load_any(folder / f"{new['name']}.json")
    if old is None:
        foreign = [name for name in names if (folder / name).exists()]
        if foreign:
            raise MatcapError(
                "another file stands here, which is of no map set",
                where=str(folder / foreign[0]),
                remedy="choose another folder with -o, or give --overwrite",
            )
        return
    differs = [key for key in _WHAT_IT_IS if old.get(key) != new.get(key)]
    if ("png" in old) and "png" not in new:
        differs.append("PNGs")
    if differs:
        raise MatcapError(
            f"another map set stands here (it differs in {', '.join(differs)})",
            where=str(folder / f"{new['name']}.json"),
            remedy="choose another folder with -o, or give --overwrite",
        )


def mapset_files(name: str) -> list[str]:
    """Names of all the files that a map set of this name may have."""
    maps = [f"{name}_{kind}.{suffix}" for kind in MEANINGS for suffix in ("exr", "png")]
    return [*maps, f"{name}.json"]


def mapset_bytes(width: int, height: int, *, png: bool) -> int:
    """Disk space that a map set of this size takes at most."""
    return width * height * (EXR_BYTES + (PNG_BYTES if png else 0)) + 1_000_000


def find_mapsets(folder: Path) -> list[Path]:
    """The JSON files of the map sets in a folder, sorted.

    A photographed piece beside its material's own set is that one's companion, and not listed.
    """
    documents = [file for file in sorted(folder.glob("*.json")) if _load_document(file) is not None]
    names = {file.stem for file in documents}
    return [file for file in documents if file.stem.removesuffix(PIECE) not in names - {file.stem}]


def _arrays(maps: MapSet, normal: NormalStyle) -> dict[str, NDArray[np.float32]]:
    """Every map as the picture that is stored: (H, W, 3) or (H, W) float32."""
    from matcap.brdf.maps import MAP_NAMES

    if maps.height.ndim != 3:
        raise ValueError("a map set is written without batch dimensions")
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
    """The JSON document of a map set of so many channels of F0, its `maps` still empty."""
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
        # What one unit of the EXR height is in plane units.
        "height_scale": 1.0,
        "normal": normal,
        **({} if specular == 1 else {SPECULAR_CHANNELS: specular}),
        "maps": {},
        "conventions": _CONVENTIONS | {"normal": f"+Y {up}"},
        "provenance": info.provenance,
    }


def meaning_of(kind: str, specular: int) -> str:
    """What a map's numbers are, in words, where F0 has so many channels."""
    coloured = kind == "specular" and specular > 1
    return MEANINGS[kind] + (", linear Rec.709, D65" if coloured else "")


def height_range(height: NDArray[np.float32]) -> tuple[float, float]:
    """(scale, midlevel) such that height = (value - midlevel) * scale fills [0, 1]."""
    low, high = float(height.min()), float(height.max())
    if high > low:
        return high - low, -low / (high - low)
    return 1.0, 0.5 - low


def coded(
    kind: str, pixels: NDArray[np.float32], scale: float, midlevel: float
) -> NDArray[np.float32]:
    """What a PNG stores of a map, in [0, 1]."""
    if kind == "diffuse":
        return srgb_picture(pixels)
    if kind == "normal":
        return 0.5 + 0.5 * pixels
    if kind == "height":
        return pixels / scale + midlevel
    return pixels


def _find_document(path: Path) -> Path:
    with suppress(OSError):  # only to be read, it can be what it is
        recover(path if path.is_dir() else path.parent)
    if path.is_file():
        return path
    if not path.is_dir():
        what = "no such file or folder" if not path.exists() else "this is no ordinary file"
        raise MatcapError(what, where=str(path), remedy="check the path")
    documents = find_mapsets(path)
    if not documents:
        raise MatcapError(
            "there is no map set in this folder",
            where=str(path),
            remedy="give a folder that matcap synth or matcap capture wrote",
        )
    if len(documents) > 1:
        names = ", ".join(file.name for file in documents)
        raise MatcapError(
            f"there are {len(documents)} map sets in this folder ({names})",
            where=str(path),
            remedy="name the JSON file of one of them",
        )
    return documents[0]


def _load_any(file: Path) -> dict[str, Any] | None:
    """A document of matcap's, of whatever version; None for any other file."""
    try:
        document = json.loads(file.read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    known = isinstance(document, dict) and str(document.get("format", "")).startswith("matcap")
    return document if known else None


def _load_document(file: Path) -> dict[str, Any] | None:
    """A map set's JSON document; None for any other file.

    Raises:
        MatcapError: the set was written by a later version.
    """
    try:
        document = json.loads(file.read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        return None
    if document.get("version") != VERSION:
        raise MatcapError(
            f"map set of version {document.get('version')}, this matcap reads {VERSION}",
            where=str(file),
            remedy="update matcap",
        )
    return document
