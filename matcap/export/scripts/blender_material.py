"""Build matcap's material in Blender 4.3 or later, from the textures beside this file.

In Blender: open this file in the Text Editor and press Run Script. Or, from a terminal:

    blender --python NAME_blender.py

Both leave a material, marked for the asset browser, and a plane as large as the maps with it on: in
metres, one for every plane unit where it was not measured. To keep the material for the asset
browser, save the file into a folder that Preferences, File Paths, Asset Libraries names.

In Cycles its reflectance is matcap's own: a Diffuse BSDF and a Metallic BSDF, whose F82 tint of
white is Schlick's Fresnel, are added. Set DISPLACE to True to move a finely divided surface by the
height.
"""

import json
from pathlib import Path

import bpy

DISPLACE = False
METRES = {"mm": 0.001, "plane unit": 1.0}


def lifted(about):
    """Metres that one unit of the height's texture is."""
    code = about["height_code"]
    return code["scale"] * METRES[code["unit"]]


def build(folder, sidecar):
    """The material of a sidecar NAME_blender.json in a folder."""
    about = json.loads((Path(folder) / sidecar).read_text())
    material = bpy.data.materials.new(about["name"])
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    files = about["textures"]

    def node(kind, x, y, **values):
        made = tree.nodes.new(kind)
        made.location = (x, y)
        for name, value in values.items():
            made.inputs[name].default_value = value
        return made

    def texture(kind, y, space):
        made = node("ShaderNodeTexImage", -900, y)
        made.image = bpy.data.images.load(str(Path(folder) / files[kind]), check_existing=True)
        made.image.colorspace_settings.name = space
        made.label = kind
        return made.outputs["Color"]

    link = tree.links.new

    def space(kind, linear):
        is_srgb = about["files"][files[kind]]["colour_space"] == "sRGB"
        return "sRGB" if is_srgb else linear

    bent = node("ShaderNodeNormalMap", -500, -400)
    link(texture("normal_gl", -500, "Non-Color"), bent.inputs["Color"])
    base = node("ShaderNodeBsdfDiffuse", -200, 300, Roughness=0.0)
    link(texture("diffuse", 400, space("diffuse", "Linear Rec.709")), base.inputs["Color"])
    gloss = node("ShaderNodeBsdfMetallic", -200, 50, **{"Edge Tint": (1.0, 1.0, 1.0, 1.0)})
    gloss.fresnel_type = "F82"
    gloss.distribution = "GGX"
    link(texture("specular", 100, space("specular", "Non-Color")), gloss.inputs["Base Color"])
    link(texture("roughness", -200, "Non-Color"), gloss.inputs["Roughness"])
    both = node("ShaderNodeAddShader", 100, 200)
    for index, lobe in enumerate((base, gloss)):
        link(bent.outputs["Normal"], lobe.inputs["Normal"])
        link(lobe.outputs["BSDF"], both.inputs[index])
    out = node("ShaderNodeOutputMaterial", 400, 200)
    link(both.outputs["Shader"], out.inputs["Surface"])
    lift = node("ShaderNodeDisplacement", 100, -300, Midlevel=0.0, Scale=lifted(about))
    link(texture("height", -800, "Non-Color"), lift.inputs["Height"])
    if DISPLACE:
        link(lift.outputs["Displacement"], out.inputs["Displacement"])
        material.displacement_method = "DISPLACEMENT"
    # Cycles darkens what a texture of normals turns far from the light: matcap does not.
    for owner in (material, getattr(material, "cycles", None)):
        if hasattr(owner, "use_bump_map_correction"):
            owner.use_bump_map_correction = False
    material.asset_mark()
    material.asset_data.description = f"Captured with matcap {about['matcap']}"
    return material


def plane(material, sidecar):
    """A plane as large as the maps, its middle at the origin, facing up."""
    about = json.loads(Path(sidecar).read_text())
    width, height = (side * METRES[about["unit"]] for side in about["tile"])
    bpy.ops.mesh.primitive_plane_add(size=1.0)
    made = bpy.context.object
    made.name = material.name
    # Not by the object's scale, which would bend the normals of the normal map.
    for vertex in made.data.vertices:
        vertex.co.x *= width
        vertex.co.y *= height
    made.data.materials.append(material)
    return made


if __name__ == "__main__":
    HERE = (
        Path(bpy.path.abspath(bpy.context.space_data.text.filepath))
        if (bpy.context.space_data and bpy.context.space_data.type == "TEXT_EDITOR")
        else Path(__file__)
    )
    SIDECAR = HERE.with_suffix(".json")
    plane(build(HERE.parent, SIDECAR.name), SIDECAR)
