"""What exporters are given and what they give back; the textures that most of them write."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from matcap.errors import UsageError
from matcap.export.texture_file import (
    CONTAINERS,
    Container,
    Depth,
    Picture,
    TextureFile,
    bands,
)

if TYPE_CHECKING:
    from torch import Tensor

    from matcap.brdf.maps import MapSet
    from matcap.export.occlusion import Occlusion
    from matcap.export.surface import TargetSurface
    from matcap.export.udim import TextureSet

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
class ExportJob:
    """A map set to be exported.

    Attributes:
        maps: without batch dimensions.
        name: what the files are called; a plain file name.
        millimetres: how long a plane unit really is; None where nobody measured it.
        depth: of all textures, instead of what suits the target.
        provenance: how the material was made; any JSON.
        container: file format of all textures that it suits, instead of the target's own.
        reach: the height, in plane units, that coded heights hold above and below the undisplaced
            level, the same for every realisation; None to find it from these maps.
        tiled: EXR files in tiles, with mipmaps.
        around: the same maps with as much around them on every side, where they are a tile of a
            texture set; it is not periodic.
        tiles: that set, whose first tile this job is; see udim.py.
    """

    maps: MapSet
    name: str
    millimetres: float | None = None
    depth: Depth | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    container: Container | None = None
    reach: float | None = None
    tiled: bool = False
    around: MapSet | None = None
    tiles: TextureSet | None = None

    @property
    def unit(self) -> str:
        """What lengths are told in: "mm" or "plane unit"."""
        return "plane unit" if self.millimetres is None else "mm"

    @property
    def unit_length(self) -> float:
        """How many of `unit` a plane unit is."""
        return 1.0 if self.millimetres is None else self.millimetres

    @property
    def metres(self) -> float:
        """How many metres a plane unit is; 1 where nobody measured it, as size_notes() says."""
        return 1.0 if self.millimetres is None else self.millimetres / 1000.0

    @property
    def extent(self) -> tuple[float, float]:
        """(width, height) of the map set, or of the whole texture set, in plane units."""
        (width, height), (columns, rows) = self.maps.size, self.grid or (1, 1)
        return columns * width * self.maps.texel_size, rows * height * self.maps.texel_size

    @property
    def grid(self) -> tuple[int, int] | None:
        """(columns, rows) of the texture set; None where there is none."""
        return None if self.tiles is None else (self.tiles.columns, self.tiles.rows)

    @property
    def repeats(self) -> bool:
        """Whether what is exported goes on at its other side."""
        return self.maps.periodic if self.tiles is None else self.tiles.period is not None

    @property
    def wrap(self) -> Literal["periodic", "clamp"]:
        """What lies beyond the border, in the words of texture files."""
        return "periodic" if self.maps.periodic else "clamp"

    def size_notes(self) -> tuple[str, ...]:
        """What users of a target that counts metres must know."""
        if self.millimetres is not None:
            return ()
        width, height = self.extent
        return (f"no real size is known: the plane is {width:.3g} x {height:.3g} m; give --unit",)

    def texture(
        self,
        make: Callable[[MapRows], Picture],
        usual: Depth,
        meaning: str,
        *,
        srgb: bool = False,
        lossy: bool = True,
    ) -> TextureFile:
        """A texture in the file format and depth that was asked for, or is usual.

        Args:
            make: its values.
            usual: depth unless another was asked for.
            meaning: of its values.
            srgb: whole numbers follow the sRGB curve.
            lossy: 8 bits will do; otherwise it stays a PNG where JPEG or WebP was asked for.

        Raises:
            UsageError: a format that has no such depth.
        """
        depth, container = self.depth or usual, self.container
        if container in ("jpg", "webp"):
            if not lossy:
                return TextureFile(
                    make, self.depth or usual, srgb, meaning, udim=self.tiles is not None
                )
            depth = self.depth or "8"
        elif container == "exr":
            depth = self.depth or (usual if usual in CONTAINERS["exr"] else "half")
        elif container is None:
            container = "png" if depth in CONTAINERS["png"] else "exr"
        if depth not in CONTAINERS[container]:
            raise UsageError(
                f"{container} has no depth {depth}",
                where="--bits",
                remedy=f"give {' or '.join(CONTAINERS[container])}",
            )
        return TextureFile(make, depth, srgb, meaning, container, self.tiles is not None)

    @cached_property
    def diffuse(self) -> Picture:
        """(H, W, 3)."""
        return self._picture(self.maps.diffuse)

    @cached_property
    def specular(self) -> Picture:
        """(H, W) F0."""
        return self._picture(self.maps.specular)

    @cached_property
    def roughness(self) -> Picture:
        """(H, W)."""
        return self._picture(self.maps.roughness)

    @cached_property
    def height(self) -> Picture:
        """(H, W), plane units."""
        return self._picture(self.maps.height)

    @cached_property
    def normal(self) -> Picture:
        """(H, W, 3), +Y up."""
        from matcap.brdf.normals import normals_of_rows

        maps = self.around or self.maps
        field, (width, height) = maps.height.detach().cpu().float(), maps.size
        made = np.empty((height, width, 3), dtype=np.float32)
        for band in bands(height):
            rows = normals_of_rows(field, maps.texel_size, band, periodic=maps.periodic)
            made[band] = rows.movedim(0, -1).numpy()
        return self._cut(made)

    @cached_property
    def _shadows(self) -> Occlusion:
        from matcap.export.occlusion import occlusion

        maps = self.around or self.maps
        field = self._picture(maps.height) / np.float32(maps.texel_size)
        return occlusion(field, periodic=maps.periodic)

    @cached_property
    def occlusion(self) -> Picture:
        """(H, W) share of an even sky's light that arrives."""
        return self._cut(self._shadows.whole("open"))

    @cached_property
    def cavity(self) -> Picture:
        """(H, W) the same, of the nearest neighbours only."""
        return self._cut(self._shadows.whole("cavity"))

    @cached_property
    def bent(self) -> Picture:
        """(H, W, 3) mean direction of what is open, +Y up."""
        return self._cut(self._shadows.whole("bent"))

    def _cut(self, wide: Picture) -> Picture:
        """What was made with its surroundings, without them."""
        width, height = self.maps.size
        down, across = (wide.shape[0] - height) // 2, (wide.shape[1] - width) // 2
        return wide[down : down + height, across : across + width]

    @staticmethod
    def _picture(tensor: Tensor) -> Picture:
        pixels: Picture = tensor.detach().cpu().float().movedim(0, -1).squeeze(-1).numpy()
        return pixels

    def picture(self, kind: str) -> Picture:
        """A map as (H, W, 3) or (H, W) float32: diffuse, specular, roughness, height, normal,
        occlusion, cavity or bent.
        """
        found: Picture = getattr(self, kind)
        return found

    def piece(self, rows: slice = slice(None), columns: slice = slice(None)) -> MapRows:
        """Some of the texels; all by default."""
        return MapRows(self, rows, columns)

    @cached_property
    def height_code(self) -> tuple[float, float]:
        """(scale, midlevel): height = (value - midlevel) * scale, scale in plane units.

        The undisplaced level is mid-grey.
        """
        known = (self.around or self.maps).height
        needed = float(known.abs().max()) if known.numel() else 0.0
        # Strengthened relief may leave the material's range; a texture set has one for all tiles.
        fits = self.tiles is not None or needed <= (self.reach or 0.0)
        return 2.0 * (self.reach if self.reach and fits else roomy(needed)), 0.5


@dataclass(frozen=True)
class MapRows:
    """Some texels of a job's maps; each is as it is in the whole."""

    job: ExportJob
    rows: slice
    columns: slice

    def picture(self, kind: str) -> Picture:
        """As ExportJob.picture."""
        return self.job.picture(kind)[self.rows, self.columns]

    @property
    def ones(self) -> Picture:
        """(H, W) of 1."""
        return np.ones_like(self.picture("roughness"))


# What a target reads from a texture: (C, H, W) float64.
Reader = Callable[[TextureFile], "Tensor"]
MadeSurface = Callable[[Reader], "TargetSurface"]


@dataclass(frozen=True)
class Export:
    """Everything that a target's folder holds, before it is written.

    Attributes:
        textures: by file name.
        documents: by file name; made when the textures stand in the folder that they are given.
        surfaces: what the target makes of the textures, by form, the one that counts first; none
            where it has no reflectance of its own.
        notes: what the user must know, a sentence each.
        facts: what else the sidecar tells; JSON.
    """

    textures: dict[str, TextureFile]
    documents: dict[str, Callable[[Path], bytes]]
    surfaces: dict[str, MadeSurface]
    notes: tuple[str, ...] = ()
    facts: dict[str, Any] = field(default_factory=dict)


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
        """PNGs of 16 bits, the height in 32-bit float and plane units."""
        return Standard(
            job.texture(picture("diffuse"), "16", DIFFUSE, srgb=True),
            job.texture(picture("specular"), "16", SPECULAR),
            job.texture(picture("roughness"), "16", ROUGHNESS),
            job.texture(coded_normal, "16", f"{NORMAL}, +Y up (OpenGL)"),
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


def known_scale(provenance: Mapping[str, Any]) -> float | None:
    """Millimetres of a plane unit that a material's history tells; None where it does not."""
    card = provenance.get("card")
    for place in (provenance, card if isinstance(card, Mapping) else {}):
        found = place.get("millimetres_per_unit")
        if isinstance(found, int | float) and 0.0 < found < float("inf"):
            return float(found)
    return None


def roomy(reach: float) -> float:
    """A round number with room above a reach: realisations of one material share it, mostly.

    The next but one of ten steps a decade (Renard's R10), 1 where there is no height.
    """
    if not reach > 0.0:
        return 1.0
    return float(10.0 ** ((np.ceil(10.0 * np.log10(reach) - 1e-9) + 1.0) / 10.0))
