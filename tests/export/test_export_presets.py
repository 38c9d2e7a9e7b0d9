"""Names and packing: each library's and engine's own, and the user's."""

import json
import re

import cv2
import numpy as np
import pytest
import torch
from exported import linear, picture

from matcap.brdf.maps import MapSet
from matcap.errors import UsageError
from matcap.export.metallic import to_metallic
from matcap.export.presets import PRESETS, PresetOptions, pack
from matcap.export.surface import residual
from matcap.export.targets import write_preset
from matcap.export.textures import ExportJob
from matcap.files.exr import read_exr

NAMES = {
    "polyhaven": {"moss_diff_1k.png", "moss_spec_1k.png", "moss_rough_1k.png", "moss_disp_1k.png",
                  "moss_nor_gl_1k.png"},
    "ambientcg": {"moss_1K-PNG_Color.png", "moss_1K-PNG_Specular.png", "moss_1K-PNG_Roughness.png",
                  "moss_1K-PNG_Displacement.png", "moss_1K-PNG_NormalGL.png"},
    "unreal": {"T_moss_BaseColor.png", "T_moss_ORM.png", "T_moss_Specular.png",
               "T_moss_Height.png", "T_moss_Normal_DX.png"},
    "unity-hdrp": {"moss_BaseMap.png", "moss_MaskMap.png", "moss_HeightMap.png",
                   "moss_Normal_GL.png"},
    "gltf": {"moss_baseColor.png", "moss_occlusionRoughnessMetallic.png", "moss_height.png",
             "moss_normal_gl.png"},
    "raw": {"moss_diffuse.exr", "moss_specular.exr", "moss_roughness.exr", "moss_height.exr",
            "moss_normal_gl.exr"},
}  # fmt: skip


def moss(**options) -> ExportJob:
    """1024 x 2 texels, so that {res} is a round one."""
    generator = torch.Generator().manual_seed(1)
    stack = torch.rand(6, 2, 1024, generator=generator)
    stack[5] *= 0.01
    return ExportJob(MapSet.from_stacked(stack, 2.0 / 1024), "moss", **options)


@pytest.mark.parametrize("preset", PRESETS)
def test_files_are_called_as_they_are_there(tmp_path, preset):
    done = write_preset(moss(), preset, tmp_path)
    assert set(done.files) == NAMES[preset] | {f"moss_{preset}.json"}
    sidecar = json.loads((tmp_path / f"moss_{preset}.json").read_text())
    assert set(sidecar["files"]) == NAMES[preset]
    assert all(about["meaning"] for about in sidecar["files"].values())


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("normal", ["gl", "dx", "both"])
def test_the_direction_of_normals_is_in_the_name_and_in_the_file(preset, normal):
    job = moss()
    files = pack(job, preset, PresetOptions(normal=normal)).textures
    found = {
        re.search(r"(gl|dx)(?=[_.]|$)", name.rsplit(".", 1)[0], re.IGNORECASE)[1].lower(): texture
        for name, texture in files.items()
        if "nor" in name.lower()
    }
    assert set(found) == ({"gl", "dx"} if normal == "both" else {normal})
    up = job.picture("normal")[..., 1]
    for way, texture in found.items():
        green = texture.seen()[..., 1]
        green = green if texture.suffix == ".exr" else 2.0 * green - 1.0
        assert np.abs(green - (up if way == "gl" else -up)).max() < 0.01


def test_unreal_packs_occlusion_roughness_metallic(tmp_path):
    job = moss()
    write_preset(job, "unreal", tmp_path)
    orm = picture(tmp_path / "T_moss_ORM.png")
    assert (orm[..., 0] == 1.0).all()
    assert np.abs(orm[..., 1] - job.picture("roughness")).max() < 0.51 / 255
    base, dielectric = (picture(tmp_path / f"T_moss_{m}.png") for m in ("BaseColor", "Specular"))
    diffuse = linear(base) * (1.0 - orm[..., 2:])
    fits = linear(base).max(axis=-1) < 0.99
    assert fits.mean() > 0.1
    assert np.abs(diffuse - job.picture("diffuse"))[fits].max() < 0.02
    f0 = 0.08 * dielectric * (1.0 - orm[..., 2]) + (linear(base) * orm[..., 2:]).mean(axis=-1)
    assert np.abs(f0 - job.picture("specular"))[fits].max() < 0.02


def test_unity_keeps_smoothness_in_alpha(tmp_path):
    job = moss()
    write_preset(job, "unity-hdrp", tmp_path)
    mask = picture(tmp_path / "moss_MaskMap.png")
    assert mask.shape[2] == 4
    assert np.abs(1.0 - mask[..., 3] - job.picture("roughness")).max() < 0.51 / 255
    assert (mask[..., 1:3] == 1.0).all()


@pytest.mark.parametrize("unit", [None, 85.0])
def test_heights_come_back_with_the_sidecar(tmp_path, unit):
    job = moss(millimetres=unit)
    write_preset(job, "polyhaven", tmp_path)
    about = json.loads((tmp_path / "moss_polyhaven.json").read_text())["height"]
    assert about["unit"] == ("mm" if unit else "plane unit")
    found = (picture(tmp_path / "moss_disp_1k.png") - about["midlevel"]) * about["scale"]
    expected = job.picture("height") * (unit or 1.0)
    assert np.abs(found - expected).max() < 1e-5 * about["scale"]


@pytest.mark.parametrize(("bits", "kind"), [("8", np.uint8), ("16", np.uint16)])
def test_bits_of_pngs(tmp_path, bits, kind):
    write_preset(moss(depth=bits), "unity-hdrp", tmp_path)
    for file in tmp_path.glob("*.png"):
        assert cv2.imread(str(file), cv2.IMREAD_UNCHANGED).dtype == kind


@pytest.mark.parametrize("bits", ["half", "float"])
def test_floats_are_the_numbers_themselves(tmp_path, bits):
    job = moss(depth=bits)
    write_preset(job, "polyhaven", tmp_path)
    assert not list(tmp_path.glob("*.png"))
    found = read_exr(tmp_path / "moss_diff_1k.exr")
    assert np.abs(found - job.picture("diffuse")).max() < 1e-3  # light, not sRGB
    normal = read_exr(tmp_path / "moss_nor_gl_1k.exr")
    assert np.abs(normal - job.picture("normal")).max() < 1e-3


def test_patterns_of_the_users_own():
    names = set(pack(moss(), "raw", PresetOptions("{map}-of-{stem}.{format}.{res}")).textures)
    assert "diffuse-of-moss.EXR.1k.exr" in names
    assert "normal_gl-of-moss.EXR.1k.exr" in names


@pytest.mark.parametrize(
    ("pattern", "said"),
    [
        ("{stem}", "two maps are called moss.exr"),
        ("{stem}_{mop}", "there is no 'mop'; did you mean 'map'"),
        ("{stem}_{map", "is no pattern"),
        ("{map.real}", "choose from stem, map, res, format"),
        ("../{map}", "plain file name"),
        ("{}", "choose from"),
    ],
)
def test_patterns_that_cannot_be(pattern, said):
    with pytest.raises(UsageError, match=re.escape(said)):
        pack(moss(), "raw", PresetOptions(pattern))


def test_only_the_maps_asked_for():
    made = pack(moss(), "polyhaven", PresetOptions(maps=["roughness", "diffuse"]))
    assert set(made.textures) == {"moss_diff_1k.png", "moss_rough_1k.png"}
    with pytest.raises(UsageError, match="'diffuze'; did you mean 'diffuse'"):
        pack(moss(), "polyhaven", PresetOptions(maps=["diffuze"]))
    with pytest.raises(UsageError, match="choose from base, mask, height, normal"):
        pack(moss(), "unity-hdrp", PresetOptions(maps=["roughness"]))


def test_unknown_presets_name_the_nearest():
    with pytest.raises(UsageError, match="did you mean 'polyhaven'"):
        pack(moss(), "PolyHeaven")


def even(value: float, shape=(4, 4)) -> np.ndarray:
    return np.full(shape, value, dtype=np.float32)


class TestMetallic:
    """The metallic workflow, against its two equations."""

    @pytest.mark.parametrize("f0", [0.04, 0.1, 0.2, 0.5])
    def test_both_equations_hold_where_they_can(self, f0):
        diffuse = np.stack([even(0.3), even(0.25), even(0.2)], axis=-1)
        found = to_metallic(diffuse, even(f0), lowest=0.04, highest=0.04)
        back = found.base * (1.0 - found.metallic)[..., None]
        mixed = 0.04 * (1.0 - found.metallic) + (found.base * found.metallic[..., None]).mean(-1)
        assert np.allclose(back, diffuse, atol=1e-5)
        assert np.allclose(mixed, f0, atol=1e-5)

    def test_plain_dielectrics_are_no_metal(self):
        found = to_metallic(even(0.5, (4, 4, 3)), even(0.05), lowest=0.0, highest=0.08)
        assert (found.metallic == 0.0).all()
        assert np.allclose(found.dielectric, 0.05)

    def test_black_metal_gets_its_colour_from_f0(self):
        found = to_metallic(even(0.0, (4, 4, 3)), even(0.6), lowest=0.04, highest=0.04)
        mixed = 0.04 * (1.0 - found.metallic) + (found.base * found.metallic[..., None]).mean(-1)
        assert np.allclose(mixed, 0.6, atol=1e-4)

    def test_grey_f0_over_coloured_diffuse_cannot_be_had_and_is_told(self):
        red = torch.zeros(3, 4, 4)
        red[0] = 0.5
        flat = torch.zeros(1, 4, 4)
        maps = MapSet(red, flat + 0.2, flat + 0.4, flat, 0.1)
        assert pack(ExportJob(maps, "red"), "unity-hdrp").surface is not None
        assert residual(maps, pack(ExportJob(maps, "red"), "unity-hdrp").surface).mean > 0.05
