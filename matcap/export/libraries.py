"""Presets in the naming of texture libraries: matcap's maps as they are, not fitted to a shader."""

from __future__ import annotations

from matcap.export.presets import (
    Preset,
    PresetTexture,
    bent,
    height,
    normal,
    occlusion,
    packed,
    plain,
)
from matcap.export.textures import CAVITY, DIFFUSE, ROUGHNESS, SPECULAR

LIBRARIES: dict[str, Preset] = {
    "polyhaven": Preset(
        "{stem}_{map}_{res}",
        {
            "diffuse": PresetTexture("diff", "16", plain("diffuse"), DIFFUSE, srgb=True),
            "specular": PresetTexture("spec", "16", plain("specular"), SPECULAR, srgb=None),
            "roughness": PresetTexture("rough", "16", plain("roughness"), ROUGHNESS),
            "occlusion": occlusion("ao", "16"),
            "arm": PresetTexture(
                "arm",
                "16",
                packed("occlusion", "roughness", "zero"),
                "R: occlusion, G: roughness, B: metallic",
            ),
            "height": height("disp"),
            "normal": normal(),
        },
        normal_labels=("nor_gl", "nor_dx"),
    ),
    "ambientcg": Preset(
        "{stem}_{res}-{format}_{map}",
        {
            "diffuse": PresetTexture("Color", "8", plain("diffuse"), DIFFUSE, srgb=True),
            "specular": PresetTexture("Specular", "16", plain("specular"), SPECULAR, srgb=None),
            "roughness": PresetTexture("Roughness", "16", plain("roughness"), ROUGHNESS),
            "occlusion": occlusion("AmbientOcclusion"),
            "height": height("Displacement"),
            "normal": normal(),
        },
        normal="both",
        normal_labels=("NormalGL", "NormalDX"),
        thousand="K",
    ),
    "raw": Preset(
        "{stem}_{map}",
        {
            "diffuse": PresetTexture("diffuse", "half", plain("diffuse"), DIFFUSE, srgb=True),
            "specular": PresetTexture("specular", "half", plain("specular"), SPECULAR, srgb=None),
            "roughness": PresetTexture("roughness", "half", plain("roughness"), ROUGHNESS),
            "occlusion": occlusion("ao", "half"),
            "cavity": PresetTexture("cavity", "half", plain("cavity"), CAVITY),
            "bent": bent("bent_normal_gl", "half"),
            "height": height("height", "float"),
            "normal": normal("half"),
        },
    ),
}
