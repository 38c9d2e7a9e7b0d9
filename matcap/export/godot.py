"""A Godot 4 material (.tres) that refers to the exported textures."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matcap.export.job import ExportJob
    from matcap.export.presets import EngineModel

LARGEST_F0 = 0.16  # F0 = 0.16 metallic_specular^2
_LAMBERT = 1
_RED, _GREEN, _BLUE = 0, 1, 2


def godot_material(job: ExportJob, files: dict[str, str], model: EngineModel) -> dict[str, str]:
    """NAME.tres, a StandardMaterial3D; paths are relative to it."""
    way = "normal_gl" if "normal_gl" in files else "normal_dx"
    linked = {"base": files["base"], "orm": files["orm"], "normal": files[way]}
    links = "\n".join(
        f'[ext_resource type="Texture2D" path="{file}" id="{kind}"]'
        for kind, file in linked.items()
    )
    specular = math.sqrt(model.dielectric[0] / LARGEST_F0)
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
