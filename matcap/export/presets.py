"""Textures without a document, named and packed as libraries and engines expect them.

The normal map's direction is always in its name. PRESETS is the table of all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from importlib.resources import files as resources
from pathlib import Path
from typing import Any, cast

import numpy as np
from torch import Tensor

from matcap.export import textures as tex
from matcap.export import workflows
from matcap.export.job import ExportJob, MapRows, Picture, brightest_channel, mean_channel, rgb
from matcap.export.options import Depth, NormalMaps, Workflow
from matcap.export.shading import (
    GLTF,
    MATCAP,
    MadeSurface,
    Reader,
    TargetShading,
    TargetSurface,
    nearest,
)
from matcap.export.texture_file import TextureFile

_MARGIN = 0.25  # share of the plain form's residual that another form must gain
_SHADED = ("occlusion", "cavity", "bent")


@dataclass(frozen=True)
class PackedMaterial:
    """A rectangle of the maps, converted to an engine's parameters."""

    piece: MapRows
    """Rows of the material's maps."""
    model: EngineModel
    """The engine's shading and parametrisation."""

    @cached_property
    def roughness(self) -> Picture:
        """(H, W) roughness, fitted to the engine's shading."""
        return workflows.fitted_tables(self.model.shading).rough(*self._meant)

    @cached_property
    def f0(self) -> Picture:
        """(H, W) or (H, W, 3) F0, fitted to the engine's shading, [0, 1]."""
        return np.clip(workflows.fitted_tables(self.model.shading).f0(*self._meant), 0.0, 1.0)

    @cached_property
    def metallic(self) -> workflows.Metallic:
        """The maps in the metallic workflow, in the model's form."""
        low, high = self.model.dielectric
        f0, rough = self._meant
        share = workflows.fitted_tables(self.model.shading).albedo(np.clip(f0, low, high), rough)
        diffuse = self.piece.picture("diffuse") * share
        wanted = workflows.MetallicAim(diffuse, self.f0, rough, low, high, self.model.below)
        return workflows.to_metallic(wanted, self.model.form)

    @property
    def base(self) -> Picture:
        """(H, W, 3) base colour of the specular workflow."""
        share = workflows.fitted_tables(self.model.shading).albedo(*self._meant)
        if self.model.conserving:
            share = share / np.maximum(1.0 - brightest_channel(self.f0), 1e-6)[..., None]
        return np.clip(self.piece.picture("diffuse") * share, 0.0, 1.0)

    @property
    def _meant(self) -> tuple[Picture, Picture]:
        return self.piece.picture("specular"), self.piece.picture("roughness")


@dataclass(frozen=True)
class EngineModel:
    """An engine's reflectance as a function of its textures."""

    shading: TargetShading
    """The engine's shading model."""
    workflow: Workflow
    """Parametrisation of the textures."""
    dielectric: tuple[float, float] = (0.0, 1.0)
    """Metallic workflow: (lowest, highest) F0 of dielectrics."""
    below: float = 1.0
    """Metallic workflow: diffuse albedo over base colour, of dielectrics."""
    conserving: bool = False
    """Specular workflow: the engine multiplies the base colour by 1 - F0."""
    even: float | None = None
    """Largest F0 of dielectrics that one setting of the material can choose; None without one."""
    form: workflows.Form = "plain"
    """Form of the metallic workflow (workflows.py)."""

    def of(self, job: ExportJob) -> EngineModel:
        """The model for a job: an engine with one F0 for all dielectrics gets the job's mean.

        At most `even`, the largest such F0 of the engine; None leaves `dielectric`.
        """
        if self.even is None:
            return self
        mean = mean_channel(job.picture("specular"))
        plain = mean[mean < workflows.FIRST_METAL]
        f0 = min(float(plain.mean()) if plain.size else self.dielectric[0], self.even)
        return replace(self, dielectric=(f0, f0))

    def nearest(self, job: ExportJob, surface: Callable[[EngineModel], MadeSurface]) -> EngineModel:
        """The model in the metallic form with the smallest residual.

        Another form than plain must gain _MARGIN: a slightly metallic leather may have a smaller
        residual, but gets a metal's tinted reflection.
        """
        forms = [replace(self, form=form) for form in workflows.FORMS]
        return forms[nearest(job, [surface(one) for one in forms], _MARGIN)]


# Computes text files from the job, the textures' file names by kind, and the engine's model.
Documents = Callable[[ExportJob, dict[str, str], EngineModel], dict[str, str]]


@dataclass(frozen=True)
class Preset:
    """Textures of a library or an engine."""

    pattern: str
    """File names without suffix; fields stem, map, res and format."""
    textures: Mapping[str, str]
    """Textures by name: "LABEL=CONTENT DEPTH", with {map} of the file name, the content's name in
    CONTENT, by default the texture's own, and the depth, by default 8."""
    normal: NormalMaps = "gl"
    """Direction of the normal map's green."""
    normal_labels: tuple[str, str] = ("normal_gl", "normal_dx")
    """Values of {map} for normals with +Y up and down."""
    thousand: str = "k"
    """Letter for 1024 in {res}."""
    model: EngineModel | None = None
    """The engine's reflectance; None for a library."""
    notes: tuple[str, ...] = ()
    """Notes for users, a sentence each."""
    documents: Documents | None = None
    """Computes text files to write with the textures."""


def _map(kind: str) -> Callable[[PackedMaterial], Picture]:
    return lambda material: material.piece.picture(kind)


# Channels of textures: (H, W) or (H, W, 3).
_CHANNELS: dict[str, Callable[[PackedMaterial], Picture]] = {
    **{kind: _map(kind) for kind in ("diffuse", "specular", "occlusion", "cavity", "height")},
    "normal": _map("normal"),
    "bent": lambda material: np.float32(0.5) + np.float32(0.5) * material.piece.picture("bent"),
    "base": lambda m: m.base if m.model.workflow == "specular" else m.metallic.base,
    "level": lambda material: material.metallic.dielectric / np.float32(_LEVEL_F0),
    "roughness": lambda material: material.roughness,
    "smoothness": lambda material: 1.0 - material.roughness,
    "metallic": lambda m: (
        0.0 * m.roughness if m.model.workflow == "specular" else m.metallic.metallic
    ),
    "F0": lambda material: rgb(material.f0),
    "zero": lambda material: 0.0 * material.roughness,
    "one": lambda material: np.ones_like(material.roughness),
}
_LEVEL_F0 = 0.08  # F0 of specular level 1, in Unreal and Substance
# Contents of textures: channels, meaning for the sidecar, and whether integers are sRGB-encoded
# (None: if F0 is coloured).
CONTENT: dict[str, tuple[str, str, bool | None]] = {
    "diffuse": ("diffuse", tex.DIFFUSE, True),
    "specular": ("specular", tex.SPECULAR, None),
    "roughness": ("roughness", tex.ROUGHNESS, False),
    "occlusion": ("occlusion", tex.OCCLUSION, False),
    "cavity": ("cavity", tex.CAVITY, False),
    "bent": ("bent", f"{tex.BENT}, +Y up (OpenGL)", False),
    "height": ("height", tex.CODED_HEIGHT, False),
    "normal": ("normal", tex.NORMAL, False),
    "base": ("base", tex.BASE, True),
    "metallic": ("metallic", "metallic", False),
    "level": ("level", "F0 / 0.08 of the dielectric", False),
    "f0": ("F0", "F0, on the sRGB curve", True),
    "f0smooth": ("F0 smoothness", "RGB: F0, on the sRGB curve, A: smoothness", True),
    "orm": ("occlusion roughness metallic", "R: occlusion, G: roughness, B: metallic", False),
    "arm": ("occlusion roughness zero", "R: occlusion, G: roughness, B: metallic", False),
    "mask": (
        "metallic occlusion one smoothness",
        "R: metallic, G: occlusion, B: detail, A: smoothness",
        False,
    ),
    "smooth": ("metallic metallic metallic smoothness", "RGB: metallic, A: smoothness", False),
}


def packed(*channels: str) -> Callable[[PackedMaterial], Picture]:
    """A function that packs channels of _CHANNELS into (H, W, C), or returns a single one."""

    def made(material: PackedMaterial) -> Picture:
        pictures = [_CHANNELS[name](material) for name in channels]
        return np.dstack(pictures) if len(pictures) > 1 else pictures[0]

    return made


def _stated(kind: str, text: str) -> tuple[str, str, Depth]:
    """(label, content, depth) of a preset's texture."""
    label, _, depth = f" {text}".rpartition(" ") if text.endswith(_DEPTHS) else (text, "", "8")
    name, _, content = label.strip().partition("=")
    return name, content or kind, cast(Depth, depth)


_DEPTHS = ("16", "half", "float")


def pack(job: ExportJob, preset: Preset) -> tex.Export:
    """Convert and pack the textures of a preset."""
    wanted = job.options.maps
    model = preset.model and _chosen(job, preset, preset.model.of(job))
    packed: dict[str, tuple[str, TextureFile]] = {}
    for kind, text in preset.textures.items():
        if wanted and kind not in wanted:
            continue
        label, _, depth = _stated(kind, text)
        if kind == "normal":
            green = job.options.normal or preset.normal
            for way in ("gl", "dx") if green == "both" else (green,):
                made = _normal(job, depth, dx=way == "dx")
                packed[f"normal_{way}"] = preset.normal_labels[way == "dx"], made
        elif kind == "height":
            packed[kind] = label, _height(job, depth)
        else:
            packed[kind] = label, _made(job, model, kind, text)
    names = _names(job, packed, preset)
    textures = {names[kind]: made for kind, (_, made) in packed.items()}
    surfaces: dict[str, MadeSurface] = {}
    documents: dict[str, bytes | Callable[[Path], bytes]] = {}
    if model is not None and not wanted:
        kinds = {kind: made for kind, (_, made) in packed.items()}
        surfaces = {model.workflow: partial(engine_surface, model, kinds)}
    if preset.documents is not None and model is not None and not wanted:
        texts = preset.documents(job, names, model)
        documents = {name: text.encode() for name, text in texts.items()}
    entries = _entries(job, preset) | {"textures": names}
    if model is not None and model.workflow == "metallic":
        entries["metallic"] = model.form
    return tex.Export(textures, documents, surfaces, preset.notes, entries)


def _chosen(job: ExportJob, preset: Preset, model: EngineModel) -> EngineModel:
    """The model, of the metallic workflow in the form with the smallest residual."""

    def surface(tried: EngineModel) -> MadeSurface:
        made = {
            kind: _made(job, tried, kind, text)
            for kind, text in preset.textures.items()
            if kind not in (*_SHADED, "height", "normal")
        }
        return partial(engine_surface, tried, made | {"normal_gl": _normal(job, "16", dx=False)})

    return model.nearest(job, surface) if model.workflow == "metallic" else model


def _names(
    job: ExportJob, packed: dict[str, tuple[str, TextureFile]], preset: Preset
) -> dict[str, str]:
    """File names by kind."""
    side = max(job.maps.size)  # in words: "2k" for 2048, "600" for 600
    res = f"{side // 1024}{preset.thousand}" if side % 1024 == 0 else str(side)
    return {
        kind: preset.pattern.format(
            stem=job.name, map=label, res=res, format=made.container.upper()
        )
        + made.suffix
        for kind, (label, made) in packed.items()
    }


def _entries(job: ExportJob, preset: Preset) -> dict[str, Any]:
    there = job.options.maps or list(preset.textures)
    entries: dict[str, Any] = {}
    if "height" in there:
        whole = _height(job, _stated("height", preset.textures["height"])[2]).whole
        entries |= tex.height_entry(job, *(job.height_code if whole else (1.0, 0.0)))
    if set(there) & {*_SHADED, "orm", "mask", "arm"}:
        entries |= tex.occlusion_entry(job)
    return entries


def _made(job: ExportJob, model: EngineModel | None, kind: str, text: str) -> TextureFile:
    source = model or EngineModel(MATCAP, "specular")
    _, content, depth = _stated(kind, text)
    channels, meaning, srgb = CONTENT[content]
    pack = packed(*channels.split())

    def make(piece: MapRows) -> Picture:
        return pack(PackedMaterial(piece, source))

    return TextureFile.of(job, make, depth, meaning, srgb=job.coloured if srgb is None else srgb)


def _height(job: ExportJob, depth: Depth) -> TextureFile:
    """The height texture: integers hold coded heights, floats plane units."""
    made = TextureFile.of(job, tex.coded_height, depth, tex.CODED_HEIGHT, lossy=False)
    return made if made.whole else replace(made, make=tex.picture("height"), meaning=tex.HEIGHT)


def _normal(job: ExportJob, depth: Depth, *, dx: bool) -> TextureFile:
    """The normal texture: integers hold 0.5 + 0.5 n, floats n."""
    up = "+Y down (DirectX)" if dx else "+Y up (OpenGL)"
    make = tex.coded_normal_dx if dx else tex.coded_normal
    made = TextureFile.of(job, make, depth, f"{tex.NORMAL}, {up}")
    if made.whole:
        return made
    meaning = f"{tex.SIGNED_NORMAL}, {up}"
    return replace(made, make=lambda piece: 2.0 * make(piece) - 1.0, meaning=meaning)


def engine_surface(
    model: EngineModel, textures: dict[str, TextureFile], read: Reader
) -> TargetSurface:
    """The reflectance that an engine renders from its textures by kind, packed or not."""
    seen = {kind: read(made) for kind, made in textures.items() if kind not in (*_SHADED, "height")}
    base = seen["base"]
    bent = _seen_normal(textures, seen)
    if model.workflow == "specular":
        f0 = seen["specular"][:3]
        below = 1.0 - f0.amax(dim=0, keepdim=True) if model.conserving else 1.0
        return TargetSurface(
            base * below, f0, _seen_roughness(seen), bent, layer=f0, shading=model.shading
        )
    channel = 2 if "orm" in seen else 0
    packed = next(seen[kind] for kind in ("orm", "mask", "smooth") if kind in seen)
    metallic = packed[channel : channel + 1]
    if "specular" in seen:
        dielectric = model.dielectric[1] * seen["specular"][:1]
    else:
        dielectric = metallic * 0.0 + model.dielectric[0]
    return TargetSurface(
        model.below * base * (1.0 - metallic),
        dielectric * (1.0 - metallic) + base * metallic,
        _seen_roughness(seen),
        bent,
        layer=dielectric,
        shading=model.shading,
    )


def _seen_roughness(seen: dict[str, Tensor]) -> Tensor:
    """Roughness from its own texture, ORM's green, or 1 - smoothness in an alpha channel."""
    if "orm" in seen:
        return seen["orm"][1:2]
    if "roughness" in seen:
        return seen["roughness"][:1]
    smooth = next(seen[kind] for kind in ("mask", "smooth", "specular") if kind in seen)
    return 1.0 - smooth[3:4]


def _seen_normal(textures: dict[str, TextureFile], seen: dict[str, Tensor]) -> Tensor:
    kind = "normal_dx" if "normal_dx" in seen else "normal_gl"
    bent = tex.signed(seen[kind]) if textures[kind].whole else seen[kind]
    sign = [1.0, -1.0 if kind == "normal_dx" else 1.0, 1.0]
    return bent * bent.new_tensor(sign)[:, None, None]


# How texture libraries and game engines name and pack their textures, in one table.
#
# An engine has a form for each workflow; if the user chooses none, PLAIN decides, and for engines
# that it does not list the form with the smaller residual is written. Libraries have matcap's maps
# as they are, not fitted to a shader.

_LARGEST_F0 = 0.16  # of Godot: F0 = 0.16 metallic_specular^2
_UNREAL_F0 = 0.08  # F0 of Unreal's and Substance's specular level 1
_UNITY_F0 = 0.04
_HAMMON = TargetShading(masking="hammon", fading=True)
_MOBILE = TargetShading(specular="mobile")
_HDRP = TargetShading(diffuse="disney")


def _godot_material(job: ExportJob, files: dict[str, str], model: EngineModel) -> dict[str, str]:
    """NAME.tres, a StandardMaterial3D of Godot 4; paths are relative to it."""
    way = "normal_gl" if "normal_gl" in files else "normal_dx"
    linked = {"base": files["base"], "orm": files["orm"], "normal": files[way]}
    links = "\n".join(
        f'[ext_resource type="Texture2D" path="{file}" id="{kind}"]'
        for kind, file in linked.items()
    )
    # diffuse_mode 1 is Lambert; texture channels 0, 1 and 2 are red, green and blue.
    text = f"""[gd_resource type="StandardMaterial3D" load_steps={len(linked) + 1} format=3]

{links}

[resource]
resource_name = "{job.name}"
diffuse_mode = 1
albedo_texture = ExtResource("base")
metallic = 1.0
metallic_specular = {math.sqrt(model.dielectric[0] / _LARGEST_F0):.6g}
metallic_texture = ExtResource("orm")
metallic_texture_channel = 2
roughness_texture = ExtResource("orm")
roughness_texture_channel = 1
normal_enabled = true
normal_texture = ExtResource("normal")
ao_enabled = true
ao_texture = ExtResource("orm")
ao_texture_channel = 0
"""
    return {f"{job.name}.tres": text}


def _unreal_import(job: ExportJob, files: dict[str, str], model: EngineModel) -> dict[str, str]:
    """T_NAME_import.py: imports the textures and builds the material, by NAME_unreal.json."""
    del files, model  # in the sidecar
    script = resources("matcap.export.scripts").joinpath("unreal_import.py").read_text()
    return {f"T_{job.name}_import.py": script}


_own = partial(Preset, "{stem}_{map}")
_unreal = partial(
    Preset,
    "T_{stem}_{map}",
    normal="dx",
    normal_labels=("Normal_GL", "Normal_DX"),
    documents=_unreal_import,
)
_unity = partial(_own, normal_labels=("Normal_GL", "Normal_DX"))
_IMPORT = "run T_*_import.py in Unreal to import them with the right settings"
_NORMAL = "set the Texture Type of Normal_GL to Normal map"

# The workflow that every project can render, even where another has a smaller residual.
PLAIN: dict[str, Workflow] = {"unreal": "metallic"}

# Textures by name: {map} of the file name, and content and depth (CONTENT) where they are
# not those of the texture's name and 8 bits.
PRESETS: dict[str, Mapping[Workflow | None, Preset]] = {
    "polyhaven": {
        None: Preset(
            "{stem}_{map}_{res}",
            {
                "diffuse": "diff 16", "specular": "spec 16", "roughness": "rough 16",
                "occlusion": "ao 16", "arm": "arm 16", "height": "disp 16", "normal": "16",
            },
            normal_labels=("nor_gl", "nor_dx"),
        )
    },
    "ambientcg": {
        None: Preset(
            "{stem}_{res}-{format}_{map}",
            {
                "diffuse": "Color", "specular": "Specular 16", "roughness": "Roughness 16",
                "occlusion": "AmbientOcclusion", "height": "Displacement 16", "normal": "16",
            },
            normal="both", normal_labels=("NormalGL", "NormalDX"), thousand="K",
        )
    },
    "raw": {
        None: _own(
            {
                "diffuse": "diffuse half", "specular": "specular half",
                "roughness": "roughness half", "occlusion": "ao half", "cavity": "cavity half",
                "bent": "bent_normal_gl half", "height": "height float", "normal": "half",
            },
        )
    },
    "unreal": {
        "metallic": _unreal(
            {
                "base": "BaseColor", "orm": "ORM", "specular": "Specular=level",
                "height": "Height 16", "normal": "16",
            },
            model=EngineModel(_HAMMON, "metallic", (0.0, _UNREAL_F0)),
            notes=("--workflow specular is closer, if the project uses Substrate", _IMPORT),
        ),
        "specular": _unreal(
            {
                "base": "DiffuseAlbedo", "specular": "F0=f0", "orm": "ORM", "height": "Height 16",
                "normal": "16",
            },
            model=EngineModel(
                TargetShading(masking="hammon", layer="albedo", compensated=True), "specular"
            ),
            notes=(
                "needs Substrate, in Unreal's project settings; --workflow metallic does not",
                _IMPORT,
            ),
        ),
    },
    "unity-hdrp": {
        "metallic": _unity(
            {
                "base": "BaseMap", "mask": "MaskMap", "bent": "BentNormalMap",
                "height": "HeightMap 16", "normal": "16",
            },
            model=EngineModel(_HDRP, "metallic", (_UNITY_F0, _UNITY_F0)),
            notes=("switch sRGB off for MaskMap, BentNormalMap and HeightMap", _NORMAL),
        ),
        "specular": _unity(
            {
                "base": "BaseMap", "specular": "SpecularColorMap=f0", "mask": "MaskMap",
                "bent": "BentNormalMap", "height": "HeightMap 16", "normal": "16",
            },
            model=EngineModel(_HDRP, "specular", conserving=True),
            notes=(
                "set Material Type to Specular Color",
                "switch sRGB off for MaskMap, BentNormalMap and HeightMap",
                _NORMAL,
            ),
        ),
    },
    "unity-urp": {
        "metallic": _unity(
            {
                "base": "BaseMap", "smooth": "MetallicSmoothness", "occlusion": "OcclusionMap",
                "height": "HeightMap 16", "normal": "16",
            },
            model=EngineModel(_MOBILE, "metallic", (_UNITY_F0, _UNITY_F0), 1.0 - _UNITY_F0),
            notes=("switch sRGB off for MetallicSmoothness, OcclusionMap and HeightMap", _NORMAL),
        ),
        "specular": _unity(
            {
                "base": "BaseMap", "specular": "SpecularSmoothness=f0smooth",
                "occlusion": "OcclusionMap", "height": "HeightMap 16", "normal": "16",
            },
            model=EngineModel(_MOBILE, "specular", conserving=True),
            notes=(
                "set Workflow Mode to Specular",
                "switch sRGB off for OcclusionMap and HeightMap",
                _NORMAL,
            ),
        ),
    },
    "gltf-textures": {
        "metallic": _own(
            {
                "base": "baseColor", "orm": "occlusionRoughnessMetallic", "height": "height 16",
                "normal": "16",
            },
            model=EngineModel(GLTF, "metallic", (_UNITY_F0, _UNITY_F0)),
            notes=("--to gltf keeps F0, with KHR_materials_specular",),
        ),
    },
    "godot": {
        "metallic": _own(
            {"base": "albedo", "orm": "orm", "height": "height 16", "normal": "16"},
            model=EngineModel(_HAMMON, "metallic", (_UNITY_F0, _UNITY_F0), even=_LARGEST_F0),
            documents=_godot_material,
        ),
    },
    "substance": {
        "metallic": _own(
            {
                "base": "basecolor", "roughness": "roughness", "mask": "metallic=metallic",
                "specular": "specularlevel=level", "occlusion": "ambientocclusion",
                "height": "height 16", "normal": "16",
            },
            normal="dx",
            model=EngineModel(TargetShading(), "metallic", (0.0, _UNREAL_F0)),
        ),
    },
}  # fmt: skip
