"""Names and packing: each library's and engine's own, and the user's."""

import json
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from exported import linear, picture
from metals import metals
from random_maps import random_maps

from matcap.brdf.maps import MapSet
from matcap.errors import UsageError
from matcap.export.job import ExportJob
from matcap.export.options import ExportOptions
from matcap.export.shading import residuals
from matcap.export.targets import TARGETS, write_export
from matcap.export.workflows import FORMS, ErrorWeights, MetallicAim, to_metallic
from matcap.files.exr import read_exr

NAMES = {
    "polyhaven": {"moss_diff_1k.png", "moss_spec_1k.png", "moss_rough_1k.png", "moss_disp_1k.png",
                  "moss_nor_gl_1k.png", "moss_ao_1k.png", "moss_arm_1k.png"},
    "ambientcg": {"moss_1K-PNG_Color.png", "moss_1K-PNG_Specular.png", "moss_1K-PNG_Roughness.png",
                  "moss_1K-PNG_Displacement.png", "moss_1K-PNG_NormalGL.png",
                  "moss_1K-PNG_NormalDX.png", "moss_1K-PNG_AmbientOcclusion.png"},
    "unreal metallic": {"T_moss_BaseColor.png", "T_moss_ORM.png", "T_moss_Specular.png",
                        "T_moss_Height.png", "T_moss_Normal_DX.png", "T_moss_import.py"},
    "unreal specular": {"T_moss_DiffuseAlbedo.png", "T_moss_ORM.png", "T_moss_F0.png",
                        "T_moss_Height.png", "T_moss_Normal_DX.png", "T_moss_import.py"},
    "unity-hdrp metallic": {"moss_BaseMap.png", "moss_MaskMap.png", "moss_HeightMap.png",
                            "moss_Normal_GL.png", "moss_BentNormalMap.png"},
    "unity-hdrp specular": {"moss_BaseMap.png", "moss_SpecularColorMap.png", "moss_MaskMap.png",
                            "moss_HeightMap.png", "moss_Normal_GL.png", "moss_BentNormalMap.png"},
    "unity-urp metallic": {"moss_BaseMap.png", "moss_MetallicSmoothness.png", "moss_HeightMap.png",
                           "moss_Normal_GL.png", "moss_OcclusionMap.png"},
    "unity-urp specular": {"moss_BaseMap.png", "moss_SpecularSmoothness.png", "moss_HeightMap.png",
                           "moss_Normal_GL.png", "moss_OcclusionMap.png"},
    "godot": {"moss_albedo.png", "moss_orm.png", "moss_height.png", "moss_normal_gl.png",
              "moss.tres"},
    "substance": {"moss_basecolor.png", "moss_roughness.png", "moss_metallic.png",
                  "moss_specularlevel.png", "moss_ambientocclusion.png", "moss_height.png",
                  "moss_normal_dx.png"},
    "gltf-textures": {"moss_baseColor.png", "moss_occlusionRoughnessMetallic.png",
                      "moss_height.png", "moss_normal_gl.png"},
    "raw": {"moss_diffuse.exr", "moss_specular.exr", "moss_roughness.exr", "moss_height.exr",
            "moss_normal_gl.exr", "moss_ao.exr", "moss_cavity.exr", "moss_bent_normal_gl.exr"},
}  # fmt: skip


def packed(job, preset):
    """The one form of a preset, or the one named after it."""
    name, _, form = preset.partition(" ")
    forms = TARGETS[name]
    return forms[form](job) if form else next(iter(forms.values()))(job)


def moss(millimetres=None, **options) -> ExportJob:
    """1024 x 2 texels, so that {res} is a round one."""
    return ExportJob(random_maps(1024, 2), "moss", millimetres, ExportOptions(**options))


@pytest.mark.parametrize("preset", NAMES)
def test_presets_have_the_file_names_of_their_libraries(tmp_path, preset):
    name, _, form = preset.partition(" ")
    done = write_export(moss(workflow=form or None), name, tmp_path)
    assert set(done.files) == NAMES[preset] | {f"moss_{name}.json"}
    sidecar = json.loads((tmp_path / f"moss_{name}.json").read_text())
    assert {*sidecar["files"], *sidecar["documents"]} == NAMES[preset]
    assert all(about["meaning"] for about in sidecar["files"].values())


@pytest.mark.parametrize("preset", ["polyhaven", "ambientcg", "unreal metallic", "raw"])
@pytest.mark.parametrize("normal", ["gl", "dx", "both"])
def test_the_direction_of_normals_is_in_the_name_and_in_the_file(preset, normal):
    job = moss(normal=normal)
    files = packed(job, preset).textures
    found = {
        re.search(r"(gl|dx)(?=[_.]|$)", name.rsplit(".", 1)[0], re.IGNORECASE)[1].lower(): texture
        for name, texture in files.items()
        if "nor" in name.lower() and "bent" not in name.lower()
    }
    assert set(found) == ({"gl", "dx"} if normal == "both" else {normal})
    up = job.picture("normal")[..., 1]
    for way, texture in found.items():
        green = texture.seen(job.piece())[..., 1]
        green = green if texture.suffix == ".exr" else 2.0 * green - 1.0
        assert np.abs(green - (up if way == "gl" else -up)).max() < 0.01


def test_unreal_packs_occlusion_roughness_metallic(tmp_path):
    job = moss()
    write_export(job, "unreal", tmp_path)
    orm = picture(tmp_path / "T_moss_ORM.png")
    assert np.abs(orm[..., 0] - job.picture("occlusion")).max() < 0.51 / 255
    # The highlight of its approximate masking is another for another roughness.
    assert np.abs(orm[..., 1] - job.picture("roughness")).max() < 0.1


@pytest.mark.parametrize("name", ["rust beside steel", "worn paint", "blue anodised"])
def test_metals_keep_albedo_and_f0_in_unreal(tmp_path, name):
    job = ExportJob(metals()[name], "moss")
    write_export(job, "unreal", tmp_path)
    orm = picture(tmp_path / "T_moss_ORM.png")
    base, dielectric = (picture(tmp_path / f"T_moss_{m}.png") for m in ("BaseColor", "Specular"))
    diffuse = linear(base) * (1.0 - orm[..., 2:])
    f0 = (0.08 * dielectric * (1.0 - orm[..., 2]))[..., None] + linear(base) * orm[..., 2:]
    assert np.abs(diffuse - job.picture("diffuse")).max() < 0.01
    wanted = job.picture("specular")
    assert np.abs(f0 / (f0.mean() / wanted.mean()) - wanted).max() < 0.03


def test_unity_keeps_smoothness_in_alpha(tmp_path):
    job = moss(workflow="specular")
    write_export(job, "unity-hdrp", tmp_path)
    mask = picture(tmp_path / "moss_MaskMap.png")
    assert mask.shape[2] == 4
    assert np.abs(1.0 - mask[..., 3] - job.picture("roughness")).max() < 0.51 / 255
    assert np.abs(mask[..., 1] - job.picture("occlusion")).max() < 0.51 / 255
    assert (mask[..., 0] == 0.0).all()  # no metal
    assert (mask[..., 2] == 1.0).all()


@pytest.mark.parametrize(
    ("preset", "file", "unit", "form"),
    [("polyhaven", "disp_1k", None, None), ("polyhaven", "disp_1k", 85.0, None),
     ("raw", "height", None, "jpg")],
)  # fmt: skip
def test_heights_are_read_back_by_the_sidecar(tmp_path, preset, file, unit, form):
    """Beside small files, too, they are codes of 16 bits."""
    job = moss(millimetres=unit, container=form)
    write_export(job, preset, tmp_path)
    about = json.loads((tmp_path / f"moss_{preset}.json").read_text())["height_code"]
    assert about["unit"] == ("mm" if unit else "plane unit")
    found = (picture(tmp_path / f"moss_{file}.png") - about["midlevel"]) * about["scale"]
    expected = job.picture("height") * (unit or 1.0)
    assert np.abs(found - expected).max() < 1e-5 * about["scale"]


@pytest.mark.parametrize(("bits", "kind"), [("8", np.uint8), ("16", np.uint16)])
def test_pngs_have_the_bits_of_the_preset(tmp_path, bits, kind):
    write_export(moss(bits=bits), "unity-hdrp", tmp_path)
    pictures = (cv2.imread(str(file), cv2.IMREAD_UNCHANGED) for file in tmp_path.glob("*.png"))
    assert {picture.dtype for picture in pictures} == {np.dtype(kind)}


@pytest.mark.parametrize("bits", ["half", "float"])
def test_float_textures_hold_the_exact_values(tmp_path, bits):
    job = moss(bits=bits)
    write_export(job, "polyhaven", tmp_path)
    assert not list(tmp_path.glob("*.png"))
    found = read_exr(tmp_path / "moss_diff_1k.exr").pixels
    assert np.abs(found - job.picture("diffuse")).max() < 1e-3  # light, not sRGB
    normal = read_exr(tmp_path / "moss_nor_gl_1k.exr").pixels
    assert np.abs(normal - job.picture("normal")).max() < 1e-3


def even(value: float, shape=(4, 4)) -> np.ndarray:
    return np.full(shape, value, dtype=np.float32)


class TestMetallic:
    """The metallic workflow, against its two equations."""

    @pytest.mark.parametrize("f0", [0.04, 0.3, 0.5])
    def test_metallic_fits_albedo_and_f0_where_a_solution_exists(self, f0):
        diffuse = np.stack([even(0.3), even(0.25), even(0.2)], axis=-1)
        found = to_metallic(MetallicAim(diffuse, even(f0), even(0.5), 0.04, 0.04))
        back = found.base * (1.0 - found.metallic)[..., None]
        mixed = 0.04 * (1.0 - found.metallic) + (found.base * found.metallic[..., None]).mean(-1)
        assert np.allclose(back, diffuse, atol=1e-3) and np.allclose(mixed, f0, atol=1e-3)

    @pytest.mark.parametrize("f0", [0.05, 0.09, 0.17, 0.2])
    def test_a_dielectric_gets_no_metallic(self, f0):
        found = to_metallic(MetallicAim(even(0.1, (4, 4, 3)), even(f0), even(0.5), 0.04, 0.04))
        assert (found.metallic == 0.0).all() and np.allclose(found.base, 0.1)

    @pytest.mark.parametrize("form", FORMS)
    def test_plain_dielectrics_keep_their_f0(self, form):
        found = to_metallic(
            MetallicAim(even(0.5, (4, 4, 3)), even(0.05), even(0.5), 0.0, 0.08), form
        )
        assert np.allclose(found.dielectric, 0.05, atol=1e-4) and np.allclose(found.metallic, 0.0)

    @pytest.mark.parametrize("form", FORMS)
    def test_black_metal_gets_its_colour_from_f0(self, form):
        black = even(0.0, (4, 4, 3))
        found = to_metallic(MetallicAim(black, even(0.6), even(0.5), 0.04, 0.04), form)
        mixed = 0.04 * (1.0 - found.metallic) + (found.base * found.metallic[..., None]).mean(-1)
        assert np.allclose(mixed, 0.6, atol=1e-3)

    @pytest.mark.parametrize("dielectric", [0.04, 0.06])
    def test_the_free_workflow_recovers_a_metallic_material(self, dielectric):
        base = np.random.default_rng(1).uniform(0.05, 0.95, (8, 8, 3)).astype(np.float32)
        share = np.random.default_rng(2).uniform(0.0, 1.0, (8, 8)).astype(np.float32)
        diffuse = base * (1.0 - share)[..., None]
        f0 = (dielectric * (1.0 - share))[..., None] + base * share[..., None]
        found = to_metallic(MetallicAim(diffuse, f0, even(0.4, (8, 8)), 0.0, 0.08), "free")
        back = found.base * (1.0 - found.metallic)[..., None]
        mixed = (found.dielectric * (1.0 - found.metallic))[..., None]
        mixed = mixed + found.base * found.metallic[..., None]
        assert np.abs(back - diffuse).max() < 0.01 and np.abs(mixed - f0).max() < 0.01

    def test_freer_forms_have_smaller_residuals(self):
        draw = np.random.default_rng(3)
        diffuse, f0 = draw.uniform(0.0, 0.6, (16, 16, 3)), draw.uniform(0.02, 0.9, (16, 16, 3))
        wanted = MetallicAim(
            diffuse.astype(np.float32), f0.astype(np.float32), even(0.9, (16, 16)), 0.04, 0.04
        )
        light = ErrorWeights.at(wanted.roughness)

        def off(form):
            found = to_metallic(wanted, form)
            rest = (1.0 - found.metallic)[..., None]
            more = found.base * rest - wanted.diffuse
            brighter = found.dielectric[..., None] * rest + found.base * (1.0 - rest) - f0
            more, brighter = more * light.diffuse[0, 0], brighter * light.specular[0, 0]
            crossed = 2.0 * light.together[0, 0] * more * brighter
            return float((more**2 + crossed + brighter**2).sum())

        assert off("free") < off("tinted") < off("plain")


class TestForms:
    """Which of three metallic forms is written: the nearest one."""

    @pytest.mark.parametrize("f0", [0.045, 0.09])
    def test_a_small_gain_does_not_make_a_dielectric_metallic(self, f0):
        """F0 = 0.09 of a brown leather would be a tenth nearer as a little of a metal."""
        assert packed(glossy(f0), "unreal metallic").entries["metallic"] == "plain"

    @pytest.mark.parametrize("preset", ["unreal metallic", "unity-hdrp metallic", "godot"])
    def test_rust_beside_steel_is_solved_texel_by_texel(self, preset):
        job = ExportJob(metals()["rust beside steel"], "rust")
        assert packed(job, preset).entries["metallic"] == "free"

    @pytest.mark.parametrize("target", ["usd", "gltf", "unity-hdrp"])
    @pytest.mark.parametrize("name", ["rust beside steel", "worn paint"])
    def test_no_solution_is_worse_than_the_plain_one(self, target, name, monkeypatch):
        job = ExportJob(metals()[name], "m")
        make = TARGETS[target]["metallic"]
        chosen = residuals(job, make(job).surfaces)["metallic"]
        monkeypatch.setattr("matcap.export.workflows.FORMS", ("plain",))
        assert chosen.mean < residuals(job, make(job).surfaces)["metallic"].mean


def glossy(f0: float, **options) -> ExportJob:
    """Brown, and as reflecting as leather that is polished: no metal, and not F0 = 0.04."""
    flat = torch.zeros(1, 8, 8)
    diffuse = torch.tensor([0.12, 0.06, 0.03])[:, None, None].expand(3, 8, 8)
    maps = MapSet(diffuse, flat + f0, flat + 0.4, flat, 0.1)
    return ExportJob(maps, "brown", options=ExportOptions(**options))


@pytest.mark.parametrize("preset", ["unity-hdrp", "unity-urp"])
def test_the_workflow_of_least_residual_is_written_and_both_are_noted(tmp_path, preset):
    done = write_export(glossy(0.09), preset, tmp_path)
    assert done.workflow == "specular" and done.residual == done.residuals["specular"]
    assert done.residual.mean < 0.03 < done.residuals["metallic"].mean
    sidecar = json.loads((tmp_path / f"brown_{preset}.json").read_text())
    assert sidecar["workflow"] == "specular"
    assert set(sidecar["residuals"]) == {"metallic", "specular"}


def test_unreal_gets_metallic_textures_by_default(tmp_path):
    done = write_export(glossy(0.09), "unreal", tmp_path)
    assert done.workflow == "metallic" and set(done.residuals) == {"metallic", "specular"}
    assert any("--workflow specular is closer" in note for note in done.notes)


def test_a_workflow_can_be_chosen(tmp_path):
    done = write_export(glossy(0.04, workflow="metallic"), "unity-hdrp", tmp_path)
    assert done.workflow == "metallic"
    assert (picture(tmp_path / "brown_MaskMap.png")[..., 0] == 0.0).all()  # leather is no metal
    with pytest.raises(UsageError, match="no specular workflow"):
        write_export(glossy(0.09, workflow="specular"), "godot", tmp_path)


def test_a_grey_f0_over_red_albedo_has_a_residual_in_the_metallic_workflow():
    forms = TARGETS["unity-hdrp"]
    job = glossy(0.4)
    off = {form: residuals(job, make(job).surfaces)[form].mean for form, make in forms.items()}
    assert off["metallic"] > 0.04 > off["specular"]


class TestHeights:
    """One range for all realisations of a material, the undisplaced level in the middle."""

    def test_mid_height_is_without_displacement(self, tmp_path):
        write_export(glossy(0.04, maps=["height"]), "polyhaven", tmp_path)
        assert np.abs(picture(tmp_path / "brown_disp_8.png") - 0.5).max() < 1e-5

    def test_all_realisations_have_the_same_range_of_heights(self):
        first, second = (moss().maps, moss().maps)
        second = replace(second, height=second.height * 0.93)
        codes = {ExportJob(maps, "moss").height_code for maps in (first, second)}
        assert len(codes) == 1
        scale, _ = codes.pop()
        assert float(first.height.abs().max()) < scale / 2.0
        assert ExportJob(first, "moss", reach=0.25).height_code == (0.5, 0.5)
        # Relief made stronger than the material has it is not clipped.
        tall = float(first.height.abs().max())
        assert ExportJob(first, "moss", reach=0.5 * tall).height_code[0] / 2.0 > tall


def chunks(png: bytes) -> dict[bytes, bytes]:
    """Of a PNG, by kind."""
    found, at = {}, 8
    while at < len(png):
        size = int.from_bytes(png[at : at + 4])
        found[png[at + 4 : at + 8]] = png[at + 8 : at + 8 + size]
        at += 12 + size
    return found


def test_pngs_state_their_colour_space_and_texel_size(tmp_path):
    write_export(moss(millimetres=102.4), "polyhaven", tmp_path)
    colour = chunks((tmp_path / "moss_diff_1k.png").read_bytes())
    plain = chunks((tmp_path / "moss_rough_1k.png").read_bytes())
    assert colour[b"sRGB"] == b"\0" and b"sRGB" not in plain
    assert int.from_bytes(plain[b"gAMA"]) == 100_000
    assert plain[b"pHYs"] == (5000).to_bytes(4) * 2 + b"\1"  # 0.2 mm each
    write_export(moss(), "polyhaven", tmp_path / "unmeasured")
    assert b"pHYs" not in chunks((tmp_path / "unmeasured" / "moss_rough_1k.png").read_bytes())


def test_presets_with_jpg_keep_heights_in_png(tmp_path):
    job = moss(container="jpg")
    done = write_export(job, "ambientcg", tmp_path)
    assert "moss_1K-JPG_Color.jpg" in done.files
    assert "moss_1K-PNG_Displacement.png" in done.files  # 8 bits would be steps
    found = picture(tmp_path / "moss_1K-JPG_Roughness.jpg")
    grey = found if found.ndim == 2 else found[..., 0]
    assert np.abs(grey - job.picture("roughness")).mean() < 0.03
