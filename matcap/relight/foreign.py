"""Map sets that matcap did not make, under the file names of ambientCG, Poly Haven and others.

    Bricks066_1K-JPG_Color.jpg  _NormalGL  _Roughness  _Displacement  _Metalness
    rock_wall_08_diff_2k.jpg    _nor_gl    _rough      _disp          _metal      _arm

Base colour and metallic become diffuse and (coloured) specular: diffuse = base (1 - metallic),
F0 = 0.04 (1 - metallic) + base metallic. Height maps of such sets have no unit: theirs is the one
whose slopes fit the normal map best. Without a height the normal map is integrated (Frankot and
Chellappa 1988, periodic). The set spans two plane units from left to right.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from matcap.errors import MatcapError
from matcap.files.srgb import srgb_decode
from matcap.relight.texture import Texture
from matcap.relight.vectors import Array

_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr")
# Of each map, the words that name it; a file belongs to the first map that one of its words names.
_WORDS: dict[str, tuple[str, ...]] = {
    "normal gl": ("normalgl", "nor_gl", "normal_gl", "normal_opengl", "nrm_gl"),
    "normal dx": ("normaldx", "nor_dx", "normal_dx", "normal_directx", "nrm_dx"),
    "packed": ("arm", "orm"),
    "metallic": ("metalness", "metallic", "metal", "mtl"),
    "roughness": ("roughness", "rough", "rgh"),
    "gloss": ("glossiness", "gloss", "smoothness"),
    "height": ("displacement", "disp", "height", "bump"),
    "normal": ("normal", "nor", "nrm", "norm"),
    "base": ("basecolor", "base_color", "albedo", "color", "colour", "diffuse", "diff", "col"),
}
_DIELECTRIC = 0.04
# Without a normal map nothing says how high a height map is: this much of its width.
_ASSUMED_RELIEF = 0.02
_STEEPEST = 20.0


@dataclass(frozen=True)
class Foreign:
    """A map set read for relighting.

    Attributes:
        texture: the material.
        notes: what had to be guessed, a sentence each.
        files: which file each map came from.
    """

    texture: Texture
    notes: tuple[str, ...]
    files: dict[str, str]


def read_foreign(folder: str | Path, *, normal: Literal["gl", "dx"] | None = None) -> Foreign:
    """Read a map set by its files' names.

    Args:
        folder: holds the pictures of one set.
        normal: which way green points, where the file's name does not say.

    Raises:
        MatcapError: no folder, no map of colour in it, two files for one map, a broken picture.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise MatcapError("no such folder", where=str(folder), remedy="check the path")
    files = _assign(folder)
    if "base" not in files:
        raise MatcapError(
            "there is no map of base colour in this folder",
            where=str(folder),
            remedy="name one ..._Color, ..._diff, ..._albedo or ..._basecolor",
        )
    notes: list[str] = []
    base = _read(files["base"], 3, linear=False)
    height_px, width_px = base.shape[1:]

    def read(kind: str, channels: int) -> Array:
        return _fitted(_read(files[kind], channels, linear=True), (width_px, height_px))

    roughness, metallic = _surface(files, read, (height_px, width_px), notes)
    texel = 2.0 / width_px
    slopes = _slopes(files, read, normal, texel, notes)
    height = read("height", 1) if "height" in files else None
    if height is not None and slopes is not None:
        height = height * _scale(height, slopes, texel, notes)
    elif height is not None:
        height = height * np.float32(_ASSUMED_RELIEF * 2.0)
        notes.append(f"no normal map: the height is taken to span {_ASSUMED_RELIEF * 2.0:g} units")
        slopes = _gradient(height, texel)
    elif slopes is not None:
        height = _integrated(slopes, texel)
        notes.append("no height map: the normal map was integrated")
    else:
        height = np.zeros((1, height_px, width_px), dtype=np.float32)
        slopes = np.zeros((2, height_px, width_px), dtype=np.float32)
        notes.append("neither normal nor height map: the surface is flat")
    assert slopes is not None
    diffuse = base * (1.0 - metallic)
    specular = _DIELECTRIC * (1.0 - metallic) + base * metallic
    if not metallic.any():
        specular = specular[:1]
    maps = (diffuse, specular, roughness, height, slopes)
    a, b, c, d, e = (np.ascontiguousarray(one, dtype=np.float32) for one in maps)
    texture = Texture(a, b, c, d, e, texel)
    return Foreign(texture, tuple(notes), {kind: file.name for kind, file in files.items()})


def _assign(folder: Path) -> dict[str, Path]:
    """The file of each map."""
    files: dict[str, Path] = {}
    for file in sorted(folder.iterdir()):
        if file.suffix.lower() not in _SUFFIXES or not file.is_file():
            continue
        kind = _kind(file.stem)
        if kind is None:
            continue
        if kind in files:
            raise MatcapError(
                f"{files[kind].name} and {file.name} are both its {kind} map",
                where=str(folder),
                remedy="keep the maps of one set in a folder",
            )
        files[kind] = file
    return files


def _kind(stem: str) -> str | None:
    """Which map a file name says it is; the last word that names one decides."""
    words = re.sub(r"[\s\-.]+", "_", stem).lower().split("_")
    for start in range(len(words) - 1, -1, -1):
        pair = "_".join(words[start : start + 2])
        for kind, names in _WORDS.items():
            if pair in names:
                return kind
    for start in range(len(words) - 1, -1, -1):
        for kind, names in _WORDS.items():
            if words[start] in names:
                return kind
    return None


def _read(file: Path, channels: int, *, linear: bool) -> Array:
    """(channels, H, W) float32; colour decoded from sRGB unless the file is linear."""
    import OpenImageIO as oiio

    source = oiio.ImageInput.open(str(file))
    pixels = None
    if source is not None:
        pixels = source.read_image("float")
        source.geterror()
        source.close()
    else:
        oiio.geterror()
    if pixels is None:
        raise MatcapError(
            "this is not a readable picture", where=str(file), remedy="download it again"
        )
    if not np.isfinite(pixels).all():
        raise MatcapError(
            "has values that are not finite (NaN or infinity)",
            where=str(file),
            remedy="replace them in a picture editor, or leave this map out",
        )
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if pixels.shape[2] < channels:
        pixels = np.repeat(pixels[..., :1], channels, axis=2)
    values = np.moveaxis(pixels[..., :channels], -1, 0).astype(np.float32)
    if not linear and file.suffix.lower() != ".exr":
        values = srgb_decode(np.clip(values, 0.0, 1.0).astype(np.float64)).astype(np.float32)
    return np.ascontiguousarray(values, dtype=np.float32)


def _fitted(values: Array, size: tuple[int, int]) -> Array:
    """(C, H, W) at (width, height), for sets whose maps differ in size."""
    import cv2

    if (values.shape[2], values.shape[1]) == size:
        return values
    way = cv2.INTER_AREA if values.shape[2] > size[0] else cv2.INTER_LINEAR
    return np.stack([cv2.resize(one, size, interpolation=way) for one in values])


def _surface(
    files: dict[str, Path],
    read: Callable[[str, int], Array],
    shape: tuple[int, int],
    notes: list[str],
) -> tuple[Array, Array]:
    """(1, H, W) roughness and metallic."""
    packed = read("packed", 3) if "packed" in files else None
    if "roughness" in files:
        roughness = read("roughness", 1)
    elif "gloss" in files:
        roughness = 1.0 - read("gloss", 1)
    elif packed is not None:
        roughness = packed[1:2]
    else:
        roughness = np.full((1, *shape), 0.5, dtype=np.float32)
        notes.append("no roughness map: 0.5 everywhere")
    if "metallic" in files:
        metallic = read("metallic", 1)
    else:
        metallic = packed[2:] if packed is not None else np.zeros((1, *shape), dtype=np.float32)
    return np.clip(roughness, 0.0, 1.0), np.clip(metallic, 0.0, 1.0)


def _slopes(
    files: dict[str, Path],
    read: Callable[[str, int], Array],
    stated: Literal["gl", "dx"] | None,
    texel: float,
    notes: list[str],
) -> Array | None:
    """(2, H, W) slopes of the normal map, y up; None without one."""
    kinds = [kind for kind in ("normal gl", "normal", "normal dx") if kind in files]
    if not kinds:
        return None
    kind = kinds[0]
    vector = read(kind, 3)
    # A channel of 8 bits cannot say 0 exactly: 127 and 128 are both straight up.
    x, y, z = 2.0 * vector - 1.0 if vector.min() >= 0.0 else vector
    z = np.maximum(z, 1.0 / _STEEPEST)
    slopes = np.stack([-x / z, -y / z])
    way = {"normal gl": "gl", "normal dx": "dx"}.get(kind, stated)
    if way is None:
        way = _guessed(slopes, read("height", 1) if "height" in files else None, texel)
        notes.append(
            f"{files[kind].name} does not say which way green points: taken as +Y "
            f"{'up (gl)' if way == 'gl' else 'down (dx)'}; say --normal if that is wrong"
        )
    if way == "dx":
        slopes[1] = -slopes[1]
    return slopes


def _guessed(slopes: Array, height: Array | None, texel: float) -> Literal["gl", "dx"]:
    """Which way green points: the way the height rises, else the way that makes a surface."""
    if height is not None:
        return "gl" if (_gradient(height, texel)[1] * slopes[1]).sum() >= 0.0 else "dx"

    def curl(sign: float) -> float:
        # A surface's slopes have none: dsx/dy = dsy/dx; rows run downwards.
        twist = np.roll(slopes[0], 1, 0) - np.roll(slopes[0], -1, 0)
        twist = twist - sign * (np.roll(slopes[1], -1, 1) - np.roll(slopes[1], 1, 1))
        return float((twist * twist).mean())

    return "gl" if curl(1.0) <= curl(-1.0) else "dx"


def _gradient(height: Array, texel: float) -> Array:
    """(2, H, W) slopes of a repeating height (1, H, W), y up."""
    field = height[0]
    across = (np.roll(field, -1, 1) - np.roll(field, 1, 1)) / (2.0 * texel)
    up = (np.roll(field, 1, 0) - np.roll(field, -1, 0)) / (2.0 * texel)
    return np.stack([across, up])


def _scale(height: Array, slopes: Array, texel: float, notes: list[str]) -> np.float32:
    """The unit of a height map: least squares of its slopes on the normal map's."""
    own = _gradient(height, texel)
    power = float((own * own).sum())
    scale = float((own * slopes).sum()) / power if power > 0.0 else 0.0
    if scale <= 0.0:
        notes.append("the height map contradicts the normal map and was left out")
        return np.float32(0.0)
    notes.append(f"height scaled by {scale:.3g} to fit the normal map")
    return np.float32(scale)


def _integrated(slopes: Array, texel: float) -> Array:
    """(1, H, W) the repeating surface whose slopes come nearest (Frankot and Chellappa 1988)."""
    rows, columns = slopes.shape[1:]
    wx = 2.0 * np.pi * np.fft.fftfreq(columns)[None, :] / texel
    wy = -2.0 * np.pi * np.fft.fftfreq(rows)[:, None] / texel
    squared = wx * wx + wy * wy
    squared[0, 0] = 1.0
    spectrum = -1j * (wx * np.fft.fft2(slopes[0]) + wy * np.fft.fft2(slopes[1])) / squared
    spectrum[0, 0] = 0.0
    return np.fft.ifft2(spectrum).real[None].astype(np.float32)
