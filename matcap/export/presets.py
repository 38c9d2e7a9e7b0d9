"""Loose textures as libraries and engines name and pack them.

A preset is a table: which pictures there are, what each is called, how it is stored and made. The
normal map's direction is part of its name wherever it goes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from string import Formatter
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.folder import plain_name
from matcap.errors import UsageError
from matcap.export.metallic import Metallic, to_metallic
from matcap.export.names import known
from matcap.export.surface import TargetSurface
from matcap.export.texture_file import Depth, Stored
from matcap.export.textures import (
    BASE,
    CODED_HEIGHT,
    DIFFUSE,
    NORMAL,
    ROUGHNESS,
    SIGNED_NORMAL,
    SPECULAR,
    Export,
    ExportJob,
    coded_normal,
    scaled_height,
    seen,
    seen_normal,
)

Normals = Literal["gl", "dx", "both"]
_FIELDS = ("stem", "map", "res", "format")
_NO_OCCLUSION = "occlusion is left white: shadows are for the renderer"


@dataclass(frozen=True)
class PackedMaterial:
    """Maps being packed, with what several pictures of a preset share."""

    job: ExportJob
    lowest: float
    highest: float
    layer: float | None

    @cached_property
    def metallic(self) -> Metallic:
        """The nearest metallic material, its base compensated for the layer above it."""
        diffuse = self.job.picture("diffuse") / np.float32(1.0 - (self.layer or 0.0))
        return to_metallic(
            diffuse, self.job.picture("specular"), lowest=self.lowest, highest=self.highest
        )

    @cached_property
    def ones(self) -> NDArray[np.float32]:
        """(H, W) of 1."""
        return np.ones_like(self.job.picture("roughness"))


@dataclass(frozen=True)
class PresetTexture:
    """One picture of a preset.

    Attributes:
        label: what {map} becomes in its name.
        depth: how it is stored unless the user says otherwise.
        make: its values.
        meaning: of its values, for the sidecar.
        srgb: a PNG of it carries the sRGB curve.
    """

    label: str
    depth: Depth
    make: Callable[[PackedMaterial], NDArray[np.float32]]
    meaning: str
    srgb: bool = False


@dataclass(frozen=True)
class Preset:
    """How a library or an engine wants its textures.

    Attributes:
        pattern: of file names, without suffix; fields stem, map, res and format.
        textures: by what --maps calls them; "height" and "normal" are made here.
        normal: the direction it wants.
        normal_labels: what {map} becomes for normals with +Y up and down.
        thousand: the letter for 1024 in {res}.
        metallic: (lowest, highest) F0 of its dielectrics where it knows metals only.
        layer: F0 of the layer that darkens its diffuse part, or None.
        notes: what users must know, a sentence each.
    """

    pattern: str
    textures: dict[str, PresetTexture]
    normal: Literal["gl", "dx"] = "gl"
    normal_labels: tuple[str, str] = ("normal_gl", "normal_dx")
    thousand: str = "k"
    metallic: tuple[float, float] | None = None
    layer: float | None = None
    notes: tuple[str, ...] = ()


def _map(kind: str) -> Callable[[PackedMaterial], NDArray[np.float32]]:
    return lambda material: material.job.picture(kind)


def _orm(material: PackedMaterial) -> NDArray[np.float32]:
    parts = (material.ones, material.job.picture("roughness"), material.metallic.metallic)
    return np.stack(parts, axis=-1)


def _mask(material: PackedMaterial) -> NDArray[np.float32]:
    ones, smoothness = material.ones, 1.0 - material.job.picture("roughness")
    return np.stack([material.metallic.metallic, ones, ones, smoothness], axis=-1)


def _base(material: PackedMaterial) -> NDArray[np.float32]:
    return material.metallic.base


def _unreal_specular(material: PackedMaterial) -> NDArray[np.float32]:
    return material.metallic.dielectric / np.float32(0.08)


# Heights and normals are made by the job's own rules; only label, depth and meaning count.
_ORM = "R: occlusion, G: roughness, B: metallic"


def _height(label: str, depth: Depth = "16") -> PresetTexture:
    return PresetTexture(label, depth, _map("height"), CODED_HEIGHT)


def _normal(depth: Depth = "16") -> PresetTexture:
    return PresetTexture("", depth, _map("normal"), NORMAL)


PRESETS: dict[str, Preset] = {
    "polyhaven": Preset(
        "{stem}_{map}_{res}",
        {
            "diffuse": PresetTexture("diff", "8", _map("diffuse"), DIFFUSE, srgb=True),
            "specular": PresetTexture("spec", "16", _map("specular"), SPECULAR),
            "roughness": PresetTexture("rough", "16", _map("roughness"), ROUGHNESS),
            "height": _height("disp"),
            "normal": _normal(),
        },
        normal_labels=("nor_gl", "nor_dx"),
    ),
    "ambientcg": Preset(
        "{stem}_{res}-{format}_{map}",
        {
            "diffuse": PresetTexture("Color", "8", _map("diffuse"), DIFFUSE, srgb=True),
            "specular": PresetTexture("Specular", "16", _map("specular"), SPECULAR),
            "roughness": PresetTexture("Roughness", "16", _map("roughness"), ROUGHNESS),
            "height": _height("Displacement"),
            "normal": _normal(),
        },
        normal_labels=("NormalGL", "NormalDX"),
        thousand="K",
    ),
    "unreal": Preset(
        "T_{stem}_{map}",
        {
            "base": PresetTexture("BaseColor", "8", _base, BASE, srgb=True),
            "orm": PresetTexture("ORM", "8", _orm, _ORM),
            "specular": PresetTexture(
                "Specular", "8", _unreal_specular, "F0 / 0.08 of the dielectric"
            ),
            "height": _height("Height"),
            "normal": _normal("8"),
        },
        normal="dx",
        normal_labels=("Normal_GL", "Normal_DX"),
        metallic=(0.0, 0.08),
        notes=(_NO_OCCLUSION, "switch sRGB off for ORM, Specular and Height"),
    ),
    "unity-hdrp": Preset(
        "{stem}_{map}",
        {
            "base": PresetTexture("BaseMap", "8", _base, BASE, srgb=True),
            "mask": PresetTexture(
                "MaskMap", "8", _mask, "R: metallic, G: occlusion, B: detail, A: smoothness"
            ),
            "height": _height("HeightMap"),
            "normal": _normal("8"),
        },
        normal_labels=("Normal_GL", "Normal_DX"),
        metallic=(0.04, 0.04),
        notes=(_NO_OCCLUSION, "switch sRGB off for MaskMap and HeightMap"),
    ),
    "gltf": Preset(
        "{stem}_{map}",
        {
            "base": PresetTexture("baseColor", "8", _base, BASE, srgb=True),
            "orm": PresetTexture("occlusionRoughnessMetallic", "8", _orm, _ORM),
            "height": _height("height"),
            "normal": _normal("8"),
        },
        metallic=(0.04, 0.04),
        layer=0.04,
        notes=(_NO_OCCLUSION, "--to gltf keeps F0, by KHR_materials_specular"),
    ),
    "raw": Preset(
        "{stem}_{map}",
        {
            "diffuse": PresetTexture("diffuse", "half", _map("diffuse"), DIFFUSE, srgb=True),
            "specular": PresetTexture("specular", "half", _map("specular"), SPECULAR),
            "roughness": PresetTexture("roughness", "half", _map("roughness"), ROUGHNESS),
            "height": _height("height", "float"),
            "normal": _normal("half"),
        },
    ),
}


@dataclass(frozen=True)
class PresetOptions:
    """What the user wants otherwise than the preset.

    Attributes:
        pattern: of file names, or None.
        maps: which pictures, in the preset's own words; empty for all.
        normal: which way green points, or None.
    """

    pattern: str | None = None
    maps: Sequence[str] = ()
    normal: Normals | None = None


def pack(job: ExportJob, name: str, choice: PresetOptions | None = None) -> Export:
    """The textures of a preset.

    Raises:
        UsageError: no such preset, map or field of a name; a name that leaves the folder, or two
            pictures of one name.
    """
    preset, choice = PRESETS[known(name, PRESETS, "--preset")], choice or PresetOptions()
    wanted = [known(one, preset.textures, f"--maps for {name}") for one in choice.maps]
    pattern = _checked(choice.pattern or preset.pattern)
    material = PackedMaterial(job, *(preset.metallic or (0.0, 1.0)), preset.layer)
    stored: dict[str, tuple[str, Stored]] = {}
    facts: dict[str, object] = {}
    for kind, texture in preset.textures.items():
        if wanted and kind not in wanted:
            continue
        depth = job.depth_or(texture.depth)
        if kind == "normal":
            for way in _ways(choice.normal or preset.normal):
                made = _stored_normal(job, depth, dx=way == "dx")
                stored[f"normal_{way}"] = (preset.normal_labels[way == "dx"], made)
        elif kind == "height":
            made, scale, midlevel = scaled_height(job, depth)
            stored[kind] = (texture.label, replace(made, meaning=texture.meaning))
            scale *= job.unit_length
            facts["height"] = {"scale": scale, "midlevel": midlevel, "unit": job.unit}
        else:
            made = Stored(texture.make(material), depth, texture.srgb, texture.meaning)
            stored[kind] = (texture.label, made)
    res = _resolution(job, preset.thousand)
    files: dict[str, Stored] = {}
    for label, made in stored.values():
        fields = {"stem": job.name, "map": label, "res": res, "format": made.suffix[1:].upper()}
        file = plain_name(pattern.format(**fields)) + made.suffix
        if file in files:
            raise UsageError(
                f"two maps are called {file}", where="--name", remedy="put {map} into the name"
            )
        files[file] = made
    whole = not wanted and preset.metallic is not None
    surface = _metallic_surface(job, preset, stored) if whole else None
    return Export(files, {}, surface, preset.notes, facts)


def _ways(normal: Normals) -> tuple[Literal["gl", "dx"], ...]:
    return ("gl", "dx") if normal == "both" else (normal,)


def _stored_normal(job: ExportJob, depth: Depth, *, dx: bool) -> Stored:
    """PNGs hold 0.5 + 0.5 n, EXR files n itself."""
    up = "+Y down (DirectX)" if dx else "+Y up (OpenGL)"
    coded = coded_normal(job, dx=dx)
    if depth in ("8", "16"):
        return Stored(coded, depth, meaning=f"{NORMAL}, {up}")
    return Stored(2.0 * coded - 1.0, depth, meaning=f"{SIGNED_NORMAL}, {up}")


def _metallic_surface(
    job: ExportJob, preset: Preset, stored: dict[str, tuple[str, Stored]]
) -> TargetSurface:
    """What an engine makes of the packed textures."""
    assert preset.metallic is not None
    files = {kind: made for kind, (_, made) in stored.items()}
    base = seen(files["base"])
    if "mask" in files:
        mask = seen(files["mask"])
        metallic, roughness = mask[:1], 1.0 - mask[3:4]
    else:
        orm = seen(files["orm"])
        metallic, roughness = orm[2:3], orm[1:2]
    if "specular" in files:
        dielectric = 0.08 * seen(files["specular"])
    else:
        dielectric = metallic * 0.0 + preset.metallic[0]
    way = "dx" if "normal_dx" in files else "gl"
    normal = seen_normal(files[f"normal_{way}"])
    if files[f"normal_{way}"].suffix == ".exr":
        normal = seen(files[f"normal_{way}"])
    if way == "dx":
        normal = normal * normal.new_tensor([1.0, -1.0, 1.0])[:, None, None]
    return TargetSurface(
        base * (1.0 - metallic),
        dielectric * (1.0 - metallic) + base * metallic,
        roughness,
        normal,
        layer=preset.layer,
    )


def _checked(pattern: str) -> str:
    """The pattern itself, every field of it known."""
    try:
        fields = [field for _, field, _, _ in Formatter().parse(pattern) if field is not None]
        for field in fields:
            known(field, _FIELDS, "--name")
        pattern.format(**dict.fromkeys(_FIELDS, ""))
    except (ValueError, IndexError, KeyError, AttributeError) as error:
        raise UsageError(
            f"'{pattern}' is no pattern ({error})",
            where="--name",
            remedy="write it like '{stem}_{map}_{res}'",
        ) from error
    return pattern


def _resolution(job: ExportJob, thousand: str) -> str:
    """The long side: "2k" for 2048, "600" for 600."""
    side = max(job.maps.size)
    return f"{side // 1024}{thousand}" if side % 1024 == 0 else str(side)
