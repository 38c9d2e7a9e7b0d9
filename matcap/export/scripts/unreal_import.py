"""Import matcap's textures into Unreal 5.3 or later, and make a material of them.

In Unreal, with the Python Editor Script Plugin: Tools, Execute Python Script, this file. Colours
are imported as sRGB, everything else as linear; the material has Default Lit's metallic workflow,
or a Substrate slab where the textures are of the specular one. Its displacement, for Nanite meshes
with tessellation, is the height's real range in centimetres.
"""

import json
from pathlib import Path

import unreal

PLACE = "/Game/matcap"
HERE = Path(__file__).resolve().parent
EDITING = unreal.MaterialEditingLibrary


def sidecar():
    """The sidecar of this script's textures: T_NAME_import.py goes with NAME_unreal.json."""
    name = Path(__file__).stem.removeprefix("T_").removesuffix("_import")
    return json.loads((HERE / f"{name}_unreal.json").read_text())


def load(about):
    """The textures by kind, imported with the settings that they need."""
    folder = f"{PLACE}/{about['name']}"
    textures = {}
    for kind, file in about["textures"].items():
        task = unreal.AssetImportTask()
        task.filename, task.destination_path = str(HERE / file), folder
        task.automated = task.replace_existing = task.save = True
        unreal.AssetToolsHelpers.get_asset_tools().import_asset_tasks([task])
        texture = unreal.load_asset(task.imported_object_paths[0])
        settings = unreal.TextureCompressionSettings
        is_colour = about["files"][file]["colour_space"] == "sRGB"
        if kind.startswith("normal"):
            compression = settings.TC_NORMALMAP
        elif kind == "height":
            compression = settings.TC_GRAYSCALE
        else:
            compression = settings.TC_DEFAULT if is_colour else settings.TC_MASKS
        texture.set_editor_property("compression_settings", compression)
        texture.set_editor_property("srgb", is_colour)
        texture.set_editor_property("flip_green_channel", kind == "normal_gl")
        unreal.EditorAssetLibrary.save_loaded_asset(texture)
        textures["normal" if kind.startswith("normal") else kind] = texture
    return textures


def build(about, textures):
    """The material, its textures connected."""
    tools = unreal.AssetToolsHelpers.get_asset_tools()
    material = tools.create_asset(
        f"M_{about['name']}", f"{PLACE}/{about['name']}", unreal.Material,
        unreal.MaterialFactoryNew(),
    )  # fmt: skip
    types = unreal.MaterialSamplerType
    samplers = {
        "base": types.SAMPLERTYPE_COLOR,
        "orm": types.SAMPLERTYPE_MASKS,
        "normal": types.SAMPLERTYPE_NORMAL,
        "height": types.SAMPLERTYPE_LINEAR_GRAYSCALE,
        "specular": types.SAMPLERTYPE_COLOR
        if about["workflow"] == "specular"
        else types.SAMPLERTYPE_MASKS,
    }
    nodes = {}
    for index, (kind, texture) in enumerate(textures.items()):
        node = EDITING.create_material_expression(
            material, unreal.MaterialExpressionTextureSample, -700, 300 * index
        )
        node.set_editor_property("texture", texture)
        node.set_editor_property("sampler_type", samplers[kind])
        nodes[kind] = node
    outputs = unreal.MaterialProperty
    if about["workflow"] == "specular":
        slab = EDITING.create_material_expression(
            material, unreal.MaterialExpressionSubstrateSlabBSDF, -250, 0
        )
        for kind, output, name in (
            ("base", "RGB", "DiffuseAlbedo"),
            ("specular", "RGB", "F0"),
            ("orm", "G", "Roughness"),
            ("normal", "RGB", "Normal"),
        ):
            EDITING.connect_material_expressions(nodes[kind], output, slab, name)
        EDITING.connect_material_property(slab, "", outputs.MP_FRONT_MATERIAL)
    else:
        for kind, output, target in (
            ("base", "RGB", outputs.MP_BASE_COLOR),
            ("specular", "R", outputs.MP_SPECULAR),
            ("orm", "G", outputs.MP_ROUGHNESS),
            ("orm", "B", outputs.MP_METALLIC),
            ("normal", "RGB", outputs.MP_NORMAL),
        ):
            EDITING.connect_material_property(nodes[kind], output, target)
    EDITING.connect_material_property(nodes["orm"], "R", outputs.MP_AMBIENT_OCCLUSION)
    displace(about, material, nodes["height"])
    EDITING.recompile_material(material)
    unreal.EditorAssetLibrary.save_loaded_asset(material)
    return material


def displace(about, material, height):
    """Nanite's displacement by the height, where this Unreal has it (5.4) and the size is known."""
    code = about["height_code"]
    if code["unit"] != "mm" or not hasattr(unreal, "DisplacementScaling"):
        return
    scaling = unreal.DisplacementScaling(magnitude=code["scale"] / 10.0, center=code["midlevel"])
    material.set_editor_property("enable_tessellation", True)
    material.set_editor_property("displacement_scaling", scaling)
    EDITING.connect_material_property(height, "R", unreal.MaterialProperty.MP_DISPLACEMENT)


ABOUT = sidecar()
build(ABOUT, load(ABOUT))
