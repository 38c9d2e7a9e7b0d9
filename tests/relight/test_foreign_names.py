"""Which map a file is, by the names that libraries, engines and programs give."""

from pathlib import Path

import pytest

from matcap.errors import MatcapError
from matcap.relight.foreign.names import OBJECT_SPACE, assigned, named

MASK = {"metallic": "R", "ambient occlusion": "G", "gloss": "A"}
ORM = {"ambient occlusion": "R", "roughness": "G", "metallic": "B"}
# (names of one folder, what each is: a map, the channels of a packed one, or None).
SETS = {
    "ambientCG": {
        "Metal007_1K-JPG_Color.jpg": "base", "Metal007_1K-JPG_Displacement.jpg": "height",
        "Metal007_1K-JPG_Metalness.jpg": "metallic", "Metal007_1K-JPG_NormalGL.jpg": "normal gl",
        "Metal007_1K-JPG_NormalDX.jpg": "normal dx", "Metal007_1K-JPG_Roughness.jpg": "roughness",
        "Metal007_1K-JPG_AmbientOcclusion.jpg": "ambient occlusion", "Metal007.png": None,
    },
    "Poly Haven, of an asset that is called after maps": {
        "rough_metal_diff_2k.jpg": "base", "rough_metal_nor_gl_2k.exr": "normal gl",
        "rough_metal_rough_2k.exr": "roughness", "rough_metal_disp_2k.png": "height",
        "rough_metal_metal_2k.exr": "metallic", "rough_metal_ao_2k.jpg": "ambient occlusion",
        "rough_metal_arm_2k.jpg": ORM, "rough_metal_thumb_2k.jpg": "preview",
    },
    "FreePBR": {
        "scuffed-metal_albedo.png": "base", "scuffed-metal_ao.png": "ambient occlusion",
        "scuffed-metal_height.png": "height", "scuffed-metal_metallic.png": "metallic",
        "scuffed-metal_normal-ogl.png": "normal gl", "scuffed-metal_roughness.png": "roughness",
        "scuffed-metal_preview.jpg": "preview",
    },
    "3DTextures": {
        "Metal_Color_Plate_013_basecolor.jpg": "base",
        "Metal_Color_Plate_013_ambientOcclusion.jpg": "ambient occlusion",
        "Metal_Color_Plate_013_height.png": "height",
        "Metal_Color_Plate_013_metallic.jpg": "metallic",
        "Metal_Color_Plate_013_normal.jpg": "normal",
        "Metal_Color_Plate_013_roughness.jpg": "roughness", "Material_1613.jpg": None,
    },
    "3DTextures, older": {
        "Stone_001_COLOR.jpg": "base", "Stone_001_DISP.png": "height",
        "Stone_001_NORM.jpg": "normal", "Stone_001_OCC.jpg": "ambient occlusion",
        "Stone_001_ROUGH.jpg": "roughness", "Stone_001_SPEC.jpg": "specular",
    },
    "Textures.com": {
        "TexturesCom_Metal_Rust4_1K_albedo.tif": "base",
        "TexturesCom_Metal_Rust4_1K_normal.tif": "normal",
        "TexturesCom_Metal_Rust4_1K_roughness.tif": "roughness",
        "TexturesCom_Metal_Rust4_1K_height.tif": "height",
        "TexturesCom_Metal_Rust4_1K_ao.tif": "ambient occlusion",
    },
    "Quixel": {
        "ucslfgys_2K_Albedo.jpg": "base", "ucslfgys_2K_Bump.jpg": "height",
        "ucslfgys_2K_Cavity.jpg": "cavity", "ucslfgys_2K_Displacement.exr": "height",
        "ucslfgys_2K_Gloss.jpg": "gloss", "ucslfgys_2K_Normal.jpg": "normal",
        "ucslfgys_2K_Fuzz.jpg": "translucency",
    },
    "Substance": {
        "DefaultMaterial_Base_Color.png": "base", "DefaultMaterial_Normal_OpenGL.png": "normal gl",
        "DefaultMaterial_Normal_DirectX.png": "normal dx",
        "DefaultMaterial_Mixed_AO.png": "ambient occlusion",
        "DefaultMaterial_Roughness.png": "roughness", "DefaultMaterial_Metallic.png": "metallic",
        "DefaultMaterial_Emissive.png": "emission",
        "DefaultMaterial_OcclusionRoughnessMetallic.png": ORM,
    },
    "Substance, specular": {
        "lambert1_Diffuse.png": "base", "lambert1_Specular.png": "specular",
        "lambert1_Glossiness.png": "gloss", "lambert1_specularlevel.png": "specular level",
    },
    "glTF": {
        "mat_baseColor.png": "base",
        "mat_metallicRoughness.png": {"roughness": "G", "metallic": "B"},
        "mat_normal.png": "normal", "mat_occlusion.png": "ambient occlusion",
        "mat_emissive.png": "emission",
        "mat_specularGlossiness.png": {"specular": "RGB", "gloss": "A"},
    },
    "Unity": {
        "crate_AlbedoTransparency.png": {"base": "RGB", "opacity": "A"},
        "crate_MetallicSmoothness.png": {"metallic": "R", "gloss": "A"},
        "crate_SpecularSmoothness.png": {"specular": "RGB", "gloss": "A"},
        "crate_Normal.png": "normal", "crate_MaskMap.png": MASK,
    },
    "Unity HDRP": {
        "crate_BaseMap.png": "base", "crate_NormalMap.png": "normal",
        "crate_BentNormalMap.png": "bent normal", "crate_SpecularColorMap.png": "specular",
        "crate_HeightMap.png": "height", "crate_Mask_Map.png": "mask",
    },
    "Unreal": {
        "T_Brick_BC.tga": "base", "T_Brick_N.tga": "normal", "T_Brick_ORM.tga": ORM,
        "T_Brick_H.tga": "height", "T_Brick_E.tga": "emission",
    },
    "Unreal, others": {
        "T_Rock_D.png": "base", "T_Rock_N.png": "normal", "T_Rock_R.png": "roughness",
        "T_Rock_M.png": "metallic",
        "T_Rock_RMA.png": {"roughness": "R", "metallic": "G", "ambient occlusion": "B"},
        "T_Rock_MRAO.png": {"metallic": "R", "roughness": "G", "ambient occlusion": "B"},
        "T_Rock_ORD.png": {"ambient occlusion": "R", "roughness": "G", "height": "B"},
        "T_Rock_AO.png": "ambient occlusion",
    },
    "Blender": {
        "Cube_Bake1_PBR_Diffuse.png": "base", "Cube_Bake1_PBR_Roughness.png": "roughness",
        "Cube_Bake1_PBR_Metalness.png": "metallic", "Cube_Bake1_PBR_Normal.png": "normal",
        "Cube_Bake1_COMBINED.png": "preview",
    },
    "letters between separators": {
        "T_Rock_BaseColor.png": "base", "T_Rock_Normal.png": "normal", "T_Rock_AO_R_M.png": ORM,
        "T_Rock_R_M.png": None,
    },
    "abbreviations between separators": {
        "Rock_albedo.png": "base", "Rock_normal.png": "normal", "Rock_ao_rough_metal.png": ORM,
    },
    "layers of OpenPBR, Arnold and glTF": {
        "m_base_color.png": "base", "m_specular_roughness.png": "roughness",
        "m_coat_roughness.png": "coating", "m_clearcoatRoughness.png": "coating",
        "m_coat_normal.png": "coating", "m_sheen_roughness.png": "coating",
        "m_transmission_roughness.png": "translucency", "m_subsurface_color.png": "translucency",
        "m_emission_color.png": "emission", "m_base_diffuse_roughness.png": "diffuse roughness",
    },
    "Arnold": {
        "m_baseColor.exr": "base", "m_specularRoughness.exr": "roughness",
        "m_diffuseRoughness.exr": "diffuse roughness",
    },
    "Terrain3D": {
        "rock023_alb_ht.png": {"base": "RGB", "height": "A"},
        "rock023_nrm_rgh.png": {"normal": "RGB", "roughness": "A"},
    },
    "spaces of normals": {
        "DefaultMaterial_BaseColor.png": "base", "DefaultMaterial_Normal.png": "normal",
        "DefaultMaterial_World Space Normal.png": {OBJECT_SPACE: "RGB"},
        "DefaultMaterial_NormalOS.png": {OBJECT_SPACE: "RGB"},
        "DefaultMaterial_normal_ws.png": {OBJECT_SPACE: "RGB"},
        "DefaultMaterial_object_normal.png": {OBJECT_SPACE: "RGB"},
    },
    "materials that are called after layers": {
        "red_coat_basecolor.png": "base", "red_coat_normal.png": "normal",
        "red_coat_roughness.png": "roughness",
    },
    "no name before the map": {
        "color.png": "base", "normal_dx.png": "normal dx", "normal_gl.png": "normal gl",
        "roughness.png": "roughness",
    },
    "a map's word that all share": {
        "wood_color.png": "base", "wood_color_ao.png": "ambient occlusion",
        "wood_color_normal.png": "normal", "wood_color_rough.png": "roughness",
    },
    "the map first": {
        "albedo_rough_wood.png": "base", "normal_rough_wood.png": "normal",
        "roughness_rough_wood.png": "roughness",
    },
    "small letters run together": {
        "wall_basecolor.png": "base", "wall_normalmap.png": "normal",
        "wall_normalgl.png": "normal gl",
        "wall_metallicroughness.png": {"roughness": "G", "metallic": "B"},
        "wall_occlusionroughnessmetallic.png": ORM,
    },
    "packed in alpha": {
        "a_AlbedoSmoothness.png": {"base": "RGB", "gloss": "A"},
        "a_NormalHeight.png": {"normal": "RGB", "height": "A"}, "a_RoughnessHeight.png": None,
        "a_NormalAlbedo.png": None,
    },
    "a single file": {"rusty_metal_rough_1k.jpg": "roughness"},
    "another": {"old color wood.png": "base"},
}  # fmt: skip


def expected(held):
    if held is None:
        return {}
    if isinstance(held, dict):
        return held
    kind = held.removesuffix(" gl").removesuffix(" dx")
    return {kind: "RGB" if kind in ("base", "normal", "specular", "bent normal") else "R"}


@pytest.mark.parametrize("source", SETS)
def test_file_names_of_libraries_are_recognised(source):
    paths = [Path(name) for name in sorted(SETS[source])]
    for file in named(paths):
        held = SETS[source][file.path.name]
        assert file.channels == expected(held), file.path.name
        if isinstance(held, str) and held.startswith("normal"):
            assert file.style == held.removeprefix("normal").strip(), file.path.name


def touch(folder, *names):
    for name in names:
        (folder / name).touch()
    return assigned(folder)


def test_of_two_files_of_a_map_one_is_used_and_the_other_named(tmp_path):
    found = touch(
        tmp_path,
        *("mud_bump_8k.png", "mud_displacement_8k.png", "mud_nor_dx_8k.png", "mud_nor_gl_8k.png"),
        *("mud_arm_8k.png", "mud_rough_8k.png", "mud_diff_8k.png", "mud_diff_8k.jpg"),
    )
    taken = {kind: file.path.name for kind, file in found.files.items()}
    assert taken == {
        "base": "mud_diff_8k.png",
        "height": "mud_displacement_8k.png",
        "normal": "mud_nor_gl_8k.png",
        "roughness": "mud_rough_8k.png",
        "metallic": "mud_arm_8k.png",
    }
    result = " ".join(found.left_out)
    for name in ("mud_bump_8k.png", "mud_nor_dx_8k.png", "mud_diff_8k.jpg"):
        assert name in result


def test_unknown_files_are_named_and_hidden_ones_are_not(tmp_path):
    found = touch(
        tmp_path, "a_Color.png", "a_xyz.png", "a_AO.png", "a.dds", "._a_Color.png", "a.txt"
    )
    assert found.left_out == (
        "a.dds (a kind of file that is not read)",
        "a_AO.png (ambient occlusion)",
        "a_xyz.png (its name names no map)",
    )


@pytest.mark.parametrize(
    "names", [("a_Color.png", "b_Color.png"), ("a_Color_1k.png", "a_diff_2k.png")]
)
def test_two_materials_or_sizes_in_a_folder_are_refused(tmp_path, names):
    with pytest.raises(MatcapError, match="are both its base map"):
        touch(tmp_path, *names)


def test_occlusion_is_never_metallic(tmp_path):
    for name in ("metal_ao.png", "metal_plate_ao_1k.jpg", "brushed-metal-ao.png", "Metal_AO.tif"):
        assert "metallic" not in named([Path(name)])[0].channels


@pytest.mark.parametrize(
    ("name", "space"),
    [
        ("m_BaseColor_ACES - ACEScg.exr", "lin_ap1"),
        ("m_BaseColor_ACES - ACES2065-1.exr", "lin_ap0"),
        ("m_BaseColor_Utility - Linear - sRGB.exr", "lin_rec709"),
        ("m_basecolor_linear.png", "lin_rec709"),
        ("m_linear_basecolor.png", "lin_rec709"),
        ("m_basecolor_raw.tif", "lin_rec709"),
        ("m_basecolor_srgb.png", ""),
        ("linear_stripes_basecolor.png", ""),
    ],
)
def test_a_colour_space_in_a_name_is_recognised(name, space):
    (file,) = named([Path(name)])
    assert file.channels == {"base": "RGB"} and file.space == space
