"""Presets: how texture libraries and game engines name and pack their textures, in one table.

An engine has a form for each workflow; if the user chooses none, PLAIN decides, and for engines
that it does not list the form with the smaller residual is written. Libraries have matcap's maps as
they are, not fitted to a shader.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from importlib.resources import files as resources

from matcap.export.gltf import SHADING as GLTF
from matcap.export.job import ExportJob
from matcap.export.presets import EngineModel, Preset
from matcap.export.shading import TargetShading
from matcap.export.textures import Workflow

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

# Textures by name: {map} of the file name, and content and depth (presets.CONTENT) where they are
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
