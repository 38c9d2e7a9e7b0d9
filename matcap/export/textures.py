"""Result of exporters, and the textures that most of them write."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from matcap.export.formats import Container, Picture
from matcap.export.job import ExportJob, MapRows
from matcap.export.texture_file import TextureFile

if TYPE_CHECKING:
    from torch import Tensor

    from matcap.export.surface import MadeSurface, Reader, TargetSurface

Workflow = Literal["metallic", "specular"]

# What textures' values are, for sidecars.
DIFFUSE = "diffuse albedo, Rec.709"
SPECULAR = "specular albedo F0"
ROUGHNESS = "perceptual roughness; GGX alpha is its square"
NORMAL = "unit normal n as 0.5 + 0.5 n"
SIGNED_NORMAL = "unit normal, each component in [-1, 1]"
HEIGHT = "height in plane units"
CODED_HEIGHT = "height = (value - midlevel) * scale"
BASE = "base colour, Rec.709"
OCCLUSION = "share of an even sky's light that arrives (ambient occlusion)"
CAVITY = "the same, with neighbours of a few texels only"
BENT = "mean direction of what is open, as 0.5 + 0.5 n"


@dataclass(frozen=True)
class Export:
    """Everything that a target's folder holds, before it is written."""

    textures: dict[str, TextureFile]
    """By file name."""
    documents: dict[str, Callable[[Path], bytes]]
    """By file name; made when the textures stand in the folder that they are given."""
    surfaces: dict[str, MadeSurface]
    """What the target makes of the textures, by form, the one that counts first; none where it has
    no reflectance of its own."""
    notes: tuple[str, ...] = ()
    """What the user must know, a sentence each."""
    facts: dict[str, Any] = field(default_factory=dict)
    """Other entries of the sidecar; JSON."""


@dataclass(frozen=True)
class Standard:
    """The five textures that documents name, for targets that add diffuse and specular."""

    diffuse: TextureFile
    specular: TextureFile
    roughness: TextureFile
    normal: TextureFile
    height: TextureFile

    @staticmethod
    def of(job: ExportJob) -> Standard:
        """PNGs of 16 bits, colours on the sRGB curve; the height in 32-bit float, plane units."""
        return Standard(
            TextureFile.of(job, picture("diffuse"), "16", DIFFUSE, srgb=True),
            TextureFile.of(job, picture("specular"), "16", SPECULAR, srgb=job.coloured),
            TextureFile.of(job, picture("roughness"), "16", ROUGHNESS),
            TextureFile.of(job, coded_normal, "16", f"{NORMAL}, +Y up (OpenGL)"),
            float_height(job),
        )

    def files(self, name: str) -> dict[str, TextureFile]:
        """By file name."""
        return {
            f"{name}_{kind}{texture.suffix}": texture
            for kind, texture in (
                ("diffuse", self.diffuse),
                ("specular", self.specular),
                ("roughness", self.roughness),
                ("normal_gl", self.normal),
                ("height", self.height),
            )
        }

    def surface(self, read: Reader) -> TargetSurface:
        """What a target that adds diffuse and specular reads."""
        from matcap.export.surface import TargetSurface

        return TargetSurface(
            read(self.diffuse), read(self.specular), read(self.roughness), signed(read(self.normal))
        )


def picture(kind: str) -> Callable[[MapRows], Picture]:
    """Makes a texture of a map as it is."""
    return lambda piece: piece.picture(kind)


def coded_normal(piece: MapRows) -> Picture:
    """(H, W, 3) 0.5 + 0.5 n, +Y up."""
    return np.float32(0.5) + np.float32(0.5) * piece.picture("normal")


def coded_normal_dx(piece: MapRows) -> Picture:
    """(H, W, 3) 0.5 + 0.5 n, green turned around for DirectX."""
    coded = coded_normal(piece)
    coded[..., 1] = np.float32(1.0) - coded[..., 1]
    return coded


def coded_height(piece: MapRows) -> Picture:
    """(H, W) height in [0, 1], mid-grey undisplaced; see ExportJob.height_code."""
    scale, midlevel = piece.job.height_code
    coded: Picture = piece.picture("height") / np.float32(scale) + np.float32(midlevel)
    return coded


def float_height(job: ExportJob) -> TextureFile:
    """The height itself in plane units, 32-bit float whatever was asked for of the others."""
    container: Container = job.container if job.container == "tx" else "exr"
    return TextureFile(picture("height"), "float", False, HEIGHT, container, job.tiles is not None)


def height_facts(job: ExportJob, scale: float, midlevel: float) -> dict[str, Any]:
    """For the sidecar: height = (value - midlevel) * scale; `scale` in plane units."""
    return {
        "height_code": {"scale": scale * job.unit_length, "midlevel": midlevel, "unit": job.unit}
    }


def occlusion_facts(job: ExportJob) -> dict[str, Any]:
    """For the sidecar: how ambient occlusion is found."""
    from matcap.export.occlusion import settings

    return {"occlusion": settings(*job.maps.size)}


def signed(coded: Tensor) -> Tensor:
    """Normals of a normal map with +Y up, as its shader has them."""
    return 2.0 * coded - 1.0
