"""Result of an exporter, and the textures that several write."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from matcap.export.job import ExportJob, MapRows, Picture
from matcap.export.occlusion import settings
from matcap.export.shading import MadeSurface, Reader, TargetSurface
from matcap.export.texture_file import TextureFile

# Meanings of textures' values, for sidecars.
DIFFUSE = "diffuse albedo, Rec.709"
SPECULAR = "specular albedo F0"
ROUGHNESS = "perceptual roughness; GGX alpha is its square"
NORMAL = "unit normal n as 0.5 + 0.5 n"
SIGNED_NORMAL = "unit normal, each component in [-1, 1]"
HEIGHT = "height in plane units"
CODED_HEIGHT = "height = (value - midlevel) * scale"
BASE = "base colour, Rec.709"
OCCLUSION = "ambient occlusion: irradiance of a uniform sky over that without occlusion"
CAVITY = "ambient occlusion by neighbours of a few texels only"
BENT = "bent normal n, the mean unoccluded direction, as 0.5 + 0.5 n"


@dataclass(frozen=True)
class Export:
    """The files of an export, before they are written."""

    textures: dict[str, TextureFile]
    """Textures by file name."""
    documents: dict[str, bytes | Callable[[Path], bytes]]
    """Contents of the other files by file name, or functions that compute them from the folder,
    with all textures written."""
    surfaces: dict[str, MadeSurface]
    """Reflectance that the target renders, by form or reader, the main one first; empty for
    unconverted maps."""
    notes: tuple[str, ...] = ()
    """Notes for the user, a sentence each."""
    entries: dict[str, Any] = field(default_factory=dict)
    """Further entries of the sidecar; JSON."""


def standard_textures(job: ExportJob) -> dict[str, TextureFile]:
    """Textures by kind, of targets that add diffuse and specular lobe as matcap does.

    diffuse, specular, roughness, normal_gl, height. By default 16-bit PNGs, colours sRGB-encoded;
    the height in 32-bit float, plane units.
    """
    of = partial(TextureFile.of, job)
    return {
        "diffuse": of(picture("diffuse"), "16", DIFFUSE, srgb=True),
        "specular": of(picture("specular"), "16", SPECULAR, srgb=job.coloured),
        "roughness": of(picture("roughness"), "16", ROUGHNESS),
        "normal_gl": of(coded_normal, "16", f"{NORMAL}, +Y up (OpenGL)"),
        "height": TextureFile(picture("height"), "float", False, HEIGHT, "exr"),
    }


def standard_surface(textures: Mapping[str, TextureFile], read: Reader) -> TargetSurface:
    """The reflectance that a target renders of standard_textures."""
    diffuse, specular, roughness = (read(textures[k]) for k in ("diffuse", "specular", "roughness"))
    return TargetSurface(diffuse, specular, roughness, signed(read(textures["normal_gl"])))


def file_names(name: str, textures: Mapping[str, TextureFile]) -> dict[str, str]:
    """File names of textures by kind: NAME_KIND and the suffix."""
    return {kind: f"{name}_{kind}{texture.suffix}" for kind, texture in textures.items()}


def by_file(name: str, textures: Mapping[str, TextureFile]) -> dict[str, TextureFile]:
    """The textures by their file_names."""
    return dict(zip(file_names(name, textures).values(), textures.values(), strict=True))


def picture(kind: str) -> Callable[[MapRows], Picture]:
    """A function that returns a map unchanged."""
    return lambda piece: piece.picture(kind)


def coded_normal(piece: MapRows) -> Picture:
    """(H, W, 3) 0.5 + 0.5 n, +Y up."""
    return np.float32(0.5) + np.float32(0.5) * piece.picture("normal")


def coded_normal_dx(piece: MapRows) -> Picture:
    """(H, W, 3) 0.5 + 0.5 n, +Y down (DirectX)."""
    coded = coded_normal(piece)
    coded[..., 1] = np.float32(1.0) - coded[..., 1]
    return coded


def coded_height(piece: MapRows) -> Picture:
    """(H, W) height in [0, 1], 0.5 undisplaced (ExportJob.height_code)."""
    scale, midlevel = piece.job.height_code
    return piece.picture("height") / np.float32(scale) + np.float32(midlevel)


def height_entry(job: ExportJob, scale: float, midlevel: float) -> dict[str, Any]:
    """The sidecar's entry: height = (value - midlevel) * scale; `scale` in plane units."""
    return {
        "height_code": {"scale": scale * job.unit_length, "midlevel": midlevel, "unit": job.unit}
    }


def occlusion_entry(job: ExportJob) -> dict[str, Any]:
    """The sidecar's entry: parameters of ambient occlusion."""
    return {"occlusion": settings(*job.maps.size)}


def signed(coded: Tensor) -> Tensor:
    """Decode normals stored as 0.5 + 0.5 n."""
    return 2.0 * coded - 1.0
