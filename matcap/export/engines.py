"""Naming and packing of textures for game engines, by workflow (metallic, specular).

If the user chooses no workflow, PLAIN decides; for engines that it does not list, the workflow with
the smaller residual is written.
"""

from __future__ import annotations

import math
from functools import partial
from importlib.resources import files as resources

import numpy as np

from matcap.export.formats import Picture
from matcap.export.gltf import SHADING as GLTF
from matcap.export.job import ExportJob
from matcap.export.presets import (
    EngineModel,
    PackedMaterial,
    Preset,
    PresetTexture,
    bent,
    height,
    normal,
    occlusion,
    packed,
)
from matcap.export.shading import TargetShading
from matcap.export.textures import BASE, Workflow

_LARGEST_F0 = 0.16  # of Godot: F0 = 0.16 metallic_specular^2
_LAMBERT = 1
_RED, _GREEN, _BLUE = 0, 1, 2


def _godot_material(job: ExportJob, files: dict[str, str], model: EngineModel) -> dict[str, str]:
    """NAME.tres, a StandardMaterial3D of Godot 4; paths are relative to it."""
    way = "normal_gl" if "normal_gl" in files else "normal_dx"
    linked = {"base": files["base"], "orm": files["orm"], "normal": files[way]}
    links = "\n".join(
        f'[ext_resource type="Texture2D" path="{file}" id="{kind}"]'
        for kind, file in linked.items()
    )
    specular = math.sqrt(model.dielectric[0] / _LARGEST_F0)
    text = f"""[gd_resource type="StandardMaterial3D" load_steps={len(linked) + 1} format=3]

{links}

[resource]
resource_name = "{job.name}"
diffuse_mode = {_LAMBERT}
albedo_texture = ExtResource("base")
metallic = 1.0
metallic_specular = {specular:.6g}
metallic_texture = ExtResource("orm")
metallic_texture_channel = {_BLUE}
roughness_texture = ExtResource("orm")
roughness_texture_channel = {_GREEN}
normal_enabled = true
normal_texture = ExtResource("normal")
ao_enabled = true
ao_texture = ExtResource("orm")
ao_texture_channel = {_RED}
"""
    return {f"{job.name}.tres": text}


_UNREAL_F0 = 0.08  # F0 of Unreal's Specular = 1
_UNITY_F0 = 0.04
_MOBILE = TargetShading(specular="mobile")
_HDRP = TargetShading(diffuse="disney")


def _unreal_import(job: ExportJob, files: dict[str, str], model: EngineModel) -> dict[str, str]:
    """T_NAME_import.py by file name: imports the textures and builds the material.

    It is the same for every material, and reads the sidecar NAME_unreal.json.
    """
    del files, model  # in the sidecar
    script = resources("matcap.export.scripts").joinpath("unreal_import.py").read_text()
    return {f"T_{job.name}_import.py": script}


def _colour(label: str) -> PresetTexture:
    """Base colour of the metallic workflow."""
    return PresetTexture(label, "8", lambda material: material.metallic.base, BASE, srgb=True)


def _below(label: str, meaning: str = BASE) -> PresetTexture:
    """Base colour of the specular workflow."""
    return PresetTexture(label, "8", lambda material: material.base, meaning, srgb=True)


def _f0(label: str) -> PresetTexture:
    return PresetTexture(label, "8", packed("F0"), "F0, on the sRGB curve", srgb=True)


def _level(label: str) -> PresetTexture:
    """Unreal's Specular."""

    def made(material: PackedMaterial) -> Picture:
        return material.metallic.dielectric / np.float32(_UNREAL_F0)

    return PresetTexture(label, "8", made, "F0 / 0.08 of the dielectric")


def _orm(label: str, metallic: str = "metallic") -> PresetTexture:
    """Occlusion, roughness and metallic, which is "zero" in the specular workflow."""
    made = packed("occlusion", "roughness", metallic)
    return PresetTexture(label, "8", made, "R: occlusion, G: roughness, B: metallic")


def _unity_mask(metallic: str = "metallic") -> PresetTexture:
    """HDRP's mask map."""
    made = packed(metallic, "occlusion", "one", "smoothness")
    meaning = "R: metallic, G: occlusion, B: detail, A: smoothness"
    return PresetTexture("MaskMap", "8", made, meaning)


def _relief(label: str) -> dict[str, PresetTexture]:
    return {"height": height(label), "normal": normal()}


_NORMALS = ("Normal_GL", "Normal_DX")
_unreal = partial(
    Preset, "T_{stem}_{map}", normal="dx", normal_labels=_NORMALS, documents=_unreal_import
)
_unity = partial(Preset, "{stem}_{map}", normal_labels=_NORMALS)
_UNREAL = ("run T_*_import.py in Unreal to import them with the right settings",)
_UNITY_NORMAL = "set the Texture Type of Normal_GL to Normal map"
_UNITY = ("switch sRGB off for MaskMap, BentNormalMap and HeightMap", _UNITY_NORMAL)

# The workflow that every project can render, even where another has a smaller residual.
PLAIN: dict[str, Workflow] = {"unreal": "metallic"}

ENGINES: dict[str, dict[Workflow, Preset]] = {
    "unreal": {
        "metallic": _unreal(
            {
                "base": _colour("BaseColor"),
                "orm": _orm("ORM"),
                "specular": _level("Specular"),
                **_relief("Height"),
            },
            model=EngineModel(
                TargetShading(masking="hammon", fading=True), "metallic", (0.0, _UNREAL_F0)
            ),
            notes=("--workflow specular is closer, if the project uses Substrate", *_UNREAL),
        ),
        "specular": _unreal(
            {
                "base": _below("DiffuseAlbedo", "diffuse albedo of a Substrate slab"),
                "specular": _f0("F0"),
                "orm": _orm("ORM", "zero"),
                **_relief("Height"),
            },
            model=EngineModel(
                TargetShading(masking="hammon", layer="albedo", compensated=True), "specular"
            ),
            notes=(
                "needs Substrate, in Unreal's project settings; --workflow metallic does not",
                *_UNREAL,
            ),
        ),
    },
    "unity-hdrp": {
        "metallic": _unity(
            {
                "base": _colour("BaseMap"),
                "mask": _unity_mask(),
                "bent": bent("BentNormalMap"),
                **_relief("HeightMap"),
            },
            model=EngineModel(_HDRP, "metallic", (_UNITY_F0, _UNITY_F0)),
            notes=_UNITY,
        ),
        "specular": _unity(
            {
                "base": _below("BaseMap"),
                "specular": _f0("SpecularColorMap"),
                "mask": _unity_mask("zero"),
                "bent": bent("BentNormalMap"),
                **_relief("HeightMap"),
            },
            model=EngineModel(_HDRP, "specular", conserving=True),
            notes=("set Material Type to Specular Color", *_UNITY),
        ),
    },
    "unity-urp": {
        "metallic": _unity(
            {
                "base": _colour("BaseMap"),
                "smooth": PresetTexture(
                    "MetallicSmoothness",
                    "8",
                    packed("metallic", "metallic", "metallic", "smoothness"),
                    "RGB: metallic, A: smoothness",
                ),
                "occlusion": occlusion("OcclusionMap"),
                **_relief("HeightMap"),
            },
            model=EngineModel(_MOBILE, "metallic", (_UNITY_F0, _UNITY_F0), 1.0 - _UNITY_F0),
            notes=(
                "switch sRGB off for MetallicSmoothness, OcclusionMap and HeightMap",
                _UNITY_NORMAL,
            ),
        ),
        "specular": _unity(
            {
                "base": _below("BaseMap"),
                "specular": PresetTexture(
                    "SpecularSmoothness",
                    "8",
                    packed("F0", "smoothness"),
                    "RGB: F0, on the sRGB curve, A: smoothness",
                    srgb=True,
                ),
                "occlusion": occlusion("OcclusionMap"),
                **_relief("HeightMap"),
            },
            model=EngineModel(_MOBILE, "specular", conserving=True),
            notes=(
                "set Workflow Mode to Specular",
                "switch sRGB off for OcclusionMap and HeightMap",
                _UNITY_NORMAL,
            ),
        ),
    },
    "gltf-textures": {
        "metallic": Preset(
            "{stem}_{map}",
            {
                "base": _colour("baseColor"),
                "orm": _orm("occlusionRoughnessMetallic"),
                **_relief("height"),
            },
            model=EngineModel(GLTF, "metallic", (_UNITY_F0, _UNITY_F0)),
            notes=("--to gltf keeps F0, with KHR_materials_specular",),
        ),
    },
    "godot": {
        "metallic": Preset(
            "{stem}_{map}",
            {
                "base": _colour("albedo"),
                "orm": _orm("orm"),
                **_relief("height"),
            },
            model=EngineModel(
                TargetShading(masking="hammon", fading=True),
                "metallic",
                (_UNITY_F0, _UNITY_F0),
                even=_LARGEST_F0,
            ),
            documents=_godot_material,
        ),
    },
    "substance": {
        "metallic": Preset(
            "{stem}_{map}",
            {
                "base": _colour("basecolor"),
                "roughness": PresetTexture("roughness", "8", packed("roughness"), "roughness"),
                "mask": PresetTexture("metallic", "8", packed("metallic"), "metallic"),
                "specular": _level("specularlevel"),
                "occlusion": occlusion("ambientocclusion"),
                **_relief("height"),
            },
            normal="dx",
            model=EngineModel(TargetShading(), "metallic", (0.0, _UNREAL_F0)),
        ),
    },
}
