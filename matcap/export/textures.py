"""What exporters are given and what they give back; the textures that most of them write."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.folder import height_range
from matcap.export.texture_file import Depth, Stored

if TYPE_CHECKING:
    from torch import Tensor

    from matcap.brdf.maps import MapSet
    from matcap.export.surface import TargetSurface

# What textures' values are, for sidecars.
DIFFUSE = "diffuse albedo, Rec.709"
SPECULAR = "specular albedo F0"
ROUGHNESS = "perceptual roughness; GGX alpha is its square"
NORMAL = "unit normal n as 0.5 + 0.5 n"
SIGNED_NORMAL = "unit normal, each component in [-1, 1]"
HEIGHT = "height in plane units"
CODED_HEIGHT = "height = (value - midlevel) * scale"
BASE = "base colour, Rec.709"


@dataclass(frozen=True)
class ExportJob:
    """A map set to be exported.

    Attributes:
        maps: without batch dimensions.
        name: what the files are called; a plain file name.
        millimetres: how long a plane unit really is; None where nobody measured it.
        depth: of all textures, instead of what suits the target.
        provenance: how the material was made; any JSON.
    """

    maps: MapSet
    name: str
    millimetres: float | None = None
    depth: Depth | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def unit(self) -> str:
        """What lengths are told in: "mm" or "plane unit"."""
        return "plane unit" if self.millimetres is None else "mm"

    @property
    def unit_length(self) -> float:
        """How many of `unit` a plane unit is."""
        return 1.0 if self.millimetres is None else self.millimetres

    @property
    def extent(self) -> tuple[float, float]:
        """(width, height) of the map set in plane units."""
        width, height = self.maps.size
        return width * self.maps.texel_size, height * self.maps.texel_size

    def depth_or(self, usual: Depth) -> Depth:
        """What the user asked for, or what is usual."""
        return self.depth or usual

    def picture(self, kind: str) -> NDArray[np.float32]:
        """A map as (H, W, 3) or (H, W) float32."""
        tensor: Tensor = getattr(self.maps, kind).detach().cpu().float()
        pixels: NDArray[np.float32] = tensor.movedim(0, -1).squeeze(-1).numpy()
        return pixels


@dataclass(frozen=True)
class Export:
    """Everything that a target's folder holds, before it is written.

    Attributes:
        textures: by file name.
        documents: by file name.
        surface: what the target makes of them; None where it has no reflectance of its own.
        notes: what the user must know, a sentence each.
        facts: what else the sidecar tells; JSON.
    """

    textures: dict[str, Stored]
    documents: dict[str, bytes]
    surface: TargetSurface | None
    notes: tuple[str, ...] = ()
    facts: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Standard:
    """The five textures that documents name, for targets that add diffuse and specular."""

    diffuse: Stored
    specular: Stored
    roughness: Stored
    normal: Stored
    height: Stored

    @staticmethod
    def of(job: ExportJob) -> Standard:
        """PNGs of 16 bits, the height in 32-bit float and plane units."""
        depth = job.depth_or("16")
        return Standard(
            Stored(job.picture("diffuse"), depth, srgb=True, meaning=DIFFUSE),
            Stored(job.picture("specular"), depth, meaning=SPECULAR),
            Stored(job.picture("roughness"), depth, meaning=ROUGHNESS),
            Stored(coded_normal(job), depth, meaning=f"{NORMAL}, +Y up (OpenGL)"),
            Stored(job.picture("height"), "float", meaning=HEIGHT),
        )

    def files(self, name: str) -> dict[str, Stored]:
        """By file name."""
        return {
            f"{name}_{kind}{stored.suffix}": stored
            for kind, stored in (
                ("diffuse", self.diffuse),
                ("specular", self.specular),
                ("roughness", self.roughness),
                ("normal_gl", self.normal),
                ("height", self.height),
            )
        }

    def surface(self) -> TargetSurface:
        """What a target that adds diffuse and specular reads."""
        from matcap.export.surface import TargetSurface

        return TargetSurface(
            seen(self.diffuse), seen(self.specular), seen(self.roughness), seen_normal(self.normal)
        )


def coded_normal(job: ExportJob, *, dx: bool = False) -> NDArray[np.float32]:
    """(H, W, 3) 0.5 + 0.5 n, green turned around for DirectX."""
    sign = np.array([1.0, -1.0 if dx else 1.0, 1.0], dtype=np.float32)
    coded: NDArray[np.float32] = np.float32(0.5) + np.float32(0.5) * sign * job.picture("normal")
    return coded


def scaled_height(job: ExportJob, depth: Depth) -> tuple[Stored, float, float]:
    """The height filling [0, 1], and (scale, midlevel): height = (value - midlevel) * scale.

    The scale is in plane units. Floats keep the height itself: scale 1, midlevel 0.
    """
    height = job.picture("height")
    if depth in ("half", "float"):
        return Stored(height, depth), 1.0, 0.0
    scale, midlevel = height_range(height)
    return Stored(height / np.float32(scale) + np.float32(midlevel), depth), scale, midlevel


def seen(stored: Stored) -> Tensor:
    """(C, H, W) of what a reader gets."""
    import torch

    values = torch.from_numpy(stored.seen())
    return values[None] if values.ndim == 2 else values.movedim(-1, 0)


def seen_normal(stored: Stored) -> Tensor:
    """(3, H, W) of what a reader of a normal map with +Y up gets."""
    return 2.0 * seen(stored) - 1.0
