"""Map sets of other programs."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import tifffile
import torch
from other_exr import write_other_exr
from PIL import Image
from relight_samples import bumpy

from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError
from matcap.export.job import ExportJob
from matcap.export.options import ExportOptions
from matcap.export.targets import write_export
from matcap.files.color import srgb_decode, srgb_picture
from matcap.files.exr import write_exr
from matcap.files.names import Note
from matcap.relight.foreign.read import read_foreign
from matcap.relight.texture import Texture

# Map sets of others, written here from a material that is known.

AMBIENTCG = {
    "base": "Bricks066_1K-PNG_Color.png",
    "gl": "Bricks066_1K-PNG_NormalGL.png",
    "dx": "Bricks066_1K-PNG_NormalDX.png",
    "rough": "Bricks066_1K-PNG_Roughness.png",
    "height": "Bricks066_1K-PNG_Displacement.png",
    "metal": "Bricks066_1K-PNG_Metalness.png",
}
POLYHAVEN = {
    "base": "rock_wall_08_diff_1k.png",
    "gl": "rock_wall_08_nor_gl_1k.png",
    "dx": "rock_wall_08_nor_dx_1k.png",
    "rough": "rock_wall_08_rough_1k.png",
    "height": "rock_wall_08_disp_1k.png",
    "metal": "rock_wall_08_metal_1k.png",
}
PLAIN = {"a_Color": "base", "a_NormalGL": "gl", "a_Roughness": "rough"}


@pytest.fixture
def maps() -> MapSet:
    return bumpy(64, 64, seed=7, relief=0.05)


def pictures_of(maps):
    """By map (H, W, C) in [0, 1], as stored."""
    height = maps.height.numpy()
    coded = (height - height.min()) / np.ptp(height)
    metal = np.broadcast_to(np.linspace(0.0, 1.0, 64, dtype=np.float32), height.shape)
    normal = 0.5 + 0.5 * maps.normal.numpy()
    stored = {
        "base": srgb_picture(maps.diffuse.numpy()),
        "gl": normal,
        "dx": np.stack([normal[0], 1.0 - normal[1], normal[2]]),
        "rough": maps.roughness.numpy(),
        "height": coded,
        "metal": metal,
    }
    return {kind: np.moveaxis(one, 0, -1).astype(np.float32) for kind, one in stored.items()}


def code(picture, bits=8):
    return np.rint(picture * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)


def png(path, picture, bits=16):
    stored = code(picture, bits)
    turned = stored[..., [2, 1, 0, 3][: stored.shape[2]]] if stored.shape[2] > 1 else stored
    cv2.imwrite(str(path), turned)


def publish(maps, folder, names, kinds):
    """Write maps the way such sites do."""
    pictures = pictures_of(maps)
    for kind in kinds:
        png(folder / names[kind], pictures[kind])


@pytest.mark.parametrize("names", [AMBIENTCG, POLYHAVEN])
@pytest.mark.parametrize("normal", ["gl", "dx"])
def test_maps_by_the_names_of_libraries_are_read(tmp_path, maps, names, normal):
    publish(maps, tmp_path, names, ["base", normal, "rough", "height"])
    found = read_foreign(tmp_path).texture
    np.testing.assert_allclose(found.diffuse, maps.diffuse, atol=1e-3)
    np.testing.assert_allclose(found.roughness, maps.roughness, atol=1e-3)
    np.testing.assert_allclose(found.specular, 0.04)
    np.testing.assert_allclose(found.normal, maps.normal, atol=2e-3)
    # The height's unit comes from the normal map.
    relief = maps.height - maps.height.mean()
    np.testing.assert_allclose(found.height - found.height.mean(), relief, atol=1e-3)
    assert found.texel_size == 2.0 / 64


def test_metal_reflects_its_colour(tmp_path, maps):
    publish(maps, tmp_path, AMBIENTCG, ["base", "gl", "rough"])
    png(tmp_path / AMBIENTCG["metal"], np.ones((64, 64, 1), np.float32))
    found = read_foreign(tmp_path).texture
    np.testing.assert_allclose(found.diffuse, 0.0, atol=1e-6)
    np.testing.assert_allclose(found.specular, maps.diffuse, atol=1e-3)


def test_height_from_the_normal_map_alone(tmp_path, maps):
    publish(maps, tmp_path, AMBIENTCG, ["base", "gl", "rough"])
    found = read_foreign(tmp_path)
    relief = maps.height - maps.height.mean()
    np.testing.assert_allclose(found.texture.height, relief, atol=1.5e-3)
    assert any("integrated" in note for note in found.notes)


@pytest.mark.parametrize("way", ["gl", "dx"])
@pytest.mark.parametrize("height", [True, False])
def test_the_direction_of_green_is_guessed_with_a_warning(tmp_path, maps, way, height):
    kinds = ["base", way, "rough"] + ["height"] * height
    names = AMBIENTCG | {"gl": "a_normal.png", "dx": "a_normal.png"}
    publish(maps, tmp_path, names, kinds)
    found = read_foreign(tmp_path)
    np.testing.assert_allclose(found.texture.normal, maps.normal, atol=2e-3)
    assert any("does not say which way green points" in note for note in found.notes)
    wrong = read_foreign(tmp_path, normal="dx" if way == "gl" else "gl")
    assert np.abs(wrong.texture.normal - maps.normal.numpy()).max() > 0.1
    assert not any("green" in note for note in wrong.notes)


def test_packed_maps_and_smaller_ones(tmp_path, maps):
    publish(maps, tmp_path, POLYHAVEN, ["base", "gl"])
    half = torch.nn.functional.avg_pool2d(maps.roughness, 2).movedim(0, -1).numpy()
    packed(tmp_path, "rock_wall_08_arm_1k.png", half, half, 0 * half)
    found = read_foreign(tmp_path).texture
    assert found.roughness.shape == (1, 64, 64)
    np.testing.assert_allclose(found.roughness, maps.roughness, atol=0.03)


def test_a_height_or_a_colour_alone_is_a_map_set(tmp_path, maps):
    publish(maps, tmp_path, AMBIENTCG, ["base", "height"])
    found = read_foreign(tmp_path)
    assert np.ptp(found.texture.height) == pytest.approx(0.04, rel=1e-3) and len(found.notes) == 2
    (tmp_path / AMBIENTCG["height"]).unlink()
    assert not read_foreign(tmp_path).texture.height.any()


def test_folders_without_a_map_set_are_refused(tmp_path, maps):
    with pytest.raises(MatcapError, match="no such folder"):
        read_foreign(tmp_path / "none")
    with pytest.raises(MatcapError, match="no map of base colour"):
        read_foreign(tmp_path)
    publish(maps, tmp_path, AMBIENTCG, ["base"])
    publish(maps, tmp_path, POLYHAVEN, ["base"])
    with pytest.raises(MatcapError, match="are both its base map"):
        read_foreign(tmp_path)
    (tmp_path / POLYHAVEN["base"]).unlink()
    (tmp_path / AMBIENTCG["base"]).write_text("no picture")
    with pytest.raises(MatcapError, match="not a readable picture"):
        read_foreign(tmp_path)


# Kinds of files, each against the same maps as plain PNGs of 16 bits.


@pytest.fixture
def plain(tmp_path, maps):
    """A folder of PNGs, the pictures in it, and what comes of them."""
    pictures = pictures_of(maps)
    for name, kind in PLAIN.items():
        png(tmp_path / f"{name}.png", pictures[kind])
    return tmp_path, pictures, read_foreign(tmp_path).texture


def same(found, expected, atol=2e-3):
    for map_ in ("diffuse", "specular", "roughness", "slopes", "height"):
        np.testing.assert_allclose(getattr(found, map_), getattr(expected, map_), atol=atol)


@pytest.mark.parametrize(("name", "kind"), [("a_Color", "base"), ("a_NormalGL", "gl")])
@pytest.mark.parametrize("form", ["png", "tif", "tga", "webp"])
def test_data_in_alpha_is_not_multiplied_in(plain, name, kind, form):
    folder, pictures, expected = plain
    alpha = np.linspace(0.0, 1.0, 64 * 64, dtype=np.float32).reshape(64, 64, 1)
    (folder / f"{name}.png").unlink()
    four = code(np.concatenate([pictures[kind], alpha], axis=-1))
    if form == "tif":
        tifffile.imwrite(folder / f"{name}.tif", four, extrasamples="unassalpha")
    else:
        lossless = {"lossless": True, "exact": True} if form == "webp" else {}
        Image.fromarray(four).save(folder / f"{name}.{form}", **lossless)
    found = read_foreign(folder)
    same(found.texture, expected, atol=0.02)
    assert any("transparency" in note for note in found.notes) == (kind == "base")


@pytest.mark.parametrize("form", ["tga", "webp", "bmp", "tif"])
def test_tga_webp_bmp_and_tiff_are_read(plain, form):
    folder, pictures, expected = plain
    for name, kind in PLAIN.items():
        (folder / f"{name}.png").unlink()
        colour = np.repeat(code(pictures[kind]), 3 // pictures[kind].shape[2], axis=-1)
        lossless = {"lossless": True} if form == "webp" else {}
        Image.fromarray(colour).save(folder / f"{name}.{form}", **lossless)
    same(read_foreign(folder).texture, expected, atol=0.02)


def test_floating_point_colours_are_linear(plain):
    folder, _, expected = plain
    (folder / "a_Color.png").unlink()
    light = np.moveaxis(expected.diffuse, 0, -1)
    tifffile.imwrite(folder / "a_Color.tif", light, photometric="rgb")
    same(read_foreign(folder).texture, expected)
    (folder / "a_Color.tif").unlink()
    write_exr(folder / "a_Color.exr", light, half=True)
    same(read_foreign(folder).texture, expected)


def exr_normals(folder, normal, names=("R", "G", "B")):
    (folder / "a_NormalGL.png").unlink()
    planes = {name: normal[..., i] for i, name in enumerate(names)}
    write_other_exr(folder / "a_NormalGL.exr", planes)


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("channels", [3, 2])
@pytest.mark.parametrize("stray", [None, -0.002, 3.0])
def test_normals_in_floats_are_judged_by_most_of_them(plain, signed, channels, stray):
    """One texel below 0 or far above 1, of resampling or compression, changes nothing else."""
    folder, pictures, expected = plain
    normal = pictures["gl"].copy()
    normal = 2.0 * normal - 1.0 if signed else normal
    if stray is not None:
        normal[3, 5, 0] = stray
    exr_normals(folder, normal[..., :channels], ("R", "G", "B")[:channels])
    off = np.abs(read_foreign(folder).texture.slopes - expected.slopes)
    off[:, 3, 5] = 0.0
    assert off.max() < 2e-3


def test_normals_named_as_vectors(plain):
    folder, pictures, expected = plain
    exr_normals(folder, 2.0 * pictures["gl"] - 1.0, ("Normal.X", "Normal.Y", "Normal.Z"))
    same(read_foreign(folder).texture, expected)


def test_normals_of_which_two_channels_are_stored(plain):
    """Blue empty, or x in alpha beside a constant red (DXT5)."""
    folder, pictures, expected = plain
    x, y, _ = np.moveaxis(pictures["gl"], -1, 0)
    full, none = np.ones_like(x), np.zeros_like(x)
    for stored in ((x, y, none), (full, y, y, x)):
        png(folder / "a_NormalGL.png", np.stack(stored, axis=-1))
        found = read_foreign(folder)
        np.testing.assert_allclose(found.texture.slopes, expected.slopes, atol=2e-3)
        assert any("z is computed" in note for note in found.notes)


@pytest.mark.parametrize(
    ("base", "normal", "way"),
    [("T_Brick_BC.png", "T_Brick_N.png", "dx"), ("b_Color.png", "b_Normal.png", "gl"),
     ("DefaultMaterial_BaseColor.png", "DefaultMaterial_Normal.png", "dx")],
)  # fmt: skip
def test_ridges_along_the_axes_point_as_is_usual_for_their_names(tmp_path, base, normal, way):
    """h = f(x) + g(y) is a surface with y turned over, too: no curl tells."""
    wave = 0.3 * np.sin(np.arange(64) * 2.0 * np.pi / 16).astype(np.float32)
    x, y = np.broadcast_arrays(wave[None, :], wave[:, None])
    vectors = np.stack([x, y, np.ones_like(x)], axis=-1)
    vectors /= np.linalg.norm(vectors, axis=-1, keepdims=True)
    png(tmp_path / normal, 0.5 + 0.5 * vectors)
    png(tmp_path / base, np.full((64, 64, 3), 0.5, np.float32))
    found = read_foreign(tmp_path).texture
    up = -vectors[..., 1] / vectors[..., 2]
    np.testing.assert_allclose(found.slopes[1], up if way == "gl" else -up, atol=2e-3)


def test_what_is_no_normal_map_is_refused(plain):
    folder, pictures, _ = plain
    png(folder / "a_NormalGL.png", pictures["rough"])
    with pytest.raises(MatcapError, match="one channel"):
        read_foreign(folder)
    png(folder / "a_NormalGL.png", pictures["gl"] * [1.0, 1.0, -1.0] + [0.0, 0.0, 1.0])
    with pytest.raises(MatcapError, match="point away"):
        read_foreign(folder)


def packed(folder, name, *planes):
    png(folder / name, np.concatenate(planes, axis=-1))


@pytest.mark.parametrize("packing", ["orm", "gltf", "unity", "hdrp"])
def test_packed_maps_by_their_packing(plain, packing):
    folder, pictures, _ = plain
    png(folder / "a_Metallic.png", pictures["metal"])
    expected = read_foreign(folder).texture
    (folder / "a_Roughness.png").unlink()
    (folder / "a_Metallic.png").unlink()
    rough, metal, other = pictures["rough"], pictures["metal"], pictures["height"]
    if packing == "orm":
        packed(folder, "a_OcclusionRoughnessMetallic.png", other, rough, metal)
    elif packing == "gltf":
        packed(folder, "a_metallicRoughness.png", other, rough, metal)
    elif packing == "unity":
        packed(folder, "a_MetallicSmoothness.png", metal, metal, metal, 1.0 - rough)
    else:
        packed(folder, "a_MaskMap.png", metal, other, other, 1.0 - rough)
    found = read_foreign(folder)
    same(found.texture, expected)
    assert not any("no roughness" in note for note in found.notes)


def test_a_packed_map_without_its_channel_is_noted(plain):
    folder, pictures, _ = plain
    (folder / "a_Roughness.png").unlink()
    packed(folder, "a_MetallicSmoothness.png", *[pictures["metal"]] * 3)
    notes = read_foreign(folder).notes
    assert any("has no channel A" in note for note in notes)
    assert any("no roughness map" in note for note in notes)


def test_specular_with_gloss_is_f0_and_without_it_is_left_out(plain):
    folder, pictures, expected = plain
    png(folder / "a_Specular.png", np.full((64, 64, 3), 0.5, np.float32))
    found = read_foreign(folder)
    same(found.texture, expected)
    assert any("a_Specular.png" in note and "not used" in note for note in found.notes)
    (folder / "a_Roughness.png").unlink()
    png(folder / "a_Glossiness.png", 1.0 - pictures["rough"])
    found = read_foreign(folder).texture
    np.testing.assert_allclose(found.specular, srgb_decode(np.array(0.5)), atol=1e-4)
    np.testing.assert_allclose(found.roughness, expected.roughness, atol=1e-4)


def test_specular_level_scales_an_f0_of_eight_percent(plain):
    folder, _, _ = plain
    png(folder / "a_specularlevel.png", np.full((64, 64, 1), 0.75, np.float32))
    np.testing.assert_allclose(read_foreign(folder).texture.specular, 0.06, atol=1e-4)


def test_a_flat_height_is_noted(plain):
    folder, pictures, expected = plain
    png(folder / "a_Displacement.png", np.full((64, 64, 1), 0.5, np.float32))
    found = read_foreign(folder)
    assert not found.texture.height.any()
    np.testing.assert_allclose(found.texture.slopes, expected.slopes)
    assert any("the height map is flat" in note for note in found.notes)
    assert not any("contradicts" in note for note in found.notes)


def test_a_bump_map_that_holds_normals_is_a_normal_map(plain):
    folder, pictures, expected = plain
    (folder / "a_NormalGL.png").rename(folder / "a_BumpMap.png")
    found = read_foreign(folder, normal="gl")
    same(found.texture, expected)
    assert any("normal map, by its colours" in note for note in found.notes)


def test_a_floating_point_height_keeps_its_range(plain):
    folder, pictures, _ = plain
    (folder / "a_NormalGL.png").unlink()
    write_exr(folder / "a_Displacement.exr", 30.0 * pictures["height"][..., 0] - 10.0, half=False)
    assert np.ptp(read_foreign(folder).texture.height) == pytest.approx(0.04, rel=1e-3)


def test_a_coloured_scalar_map_is_noted(plain):
    folder, pictures, _ = plain
    png(folder / "a_Roughness.png", pictures["base"])
    assert any("is coloured" in note for note in read_foreign(folder).notes)


def test_the_largest_map_sets_the_size(plain):
    folder, _, expected = plain
    png(folder / "a_Color.png", np.full((1, 1, 3), 0.5, np.float32))
    np.testing.assert_allclose(read_foreign(folder).texture.slopes, expected.slopes)
    png(folder / "a_Color.png", np.full((64, 32, 3), 0.5, np.float32))
    with pytest.raises(MatcapError, match="another aspect ratio"):
        read_foreign(folder)


def test_a_smaller_height_map_is_no_facets(tmp_path):
    """Of a height map a quarter of the size, waves of 8 texels; bilinear slopes are steps."""
    y, x = np.mgrid[:128, :128] / 4.0 - 0.375
    wave = 0.5 + 0.2 * np.sin(2.0 * np.pi * x / 8.0) * np.cos(2.0 * np.pi * y / 8.0)
    png(tmp_path / "a_Color.png", np.full((128, 128, 3), 0.5, np.float32))
    png(tmp_path / "a_Displacement.png", wave[:, :, None])
    whole = read_foreign(tmp_path).texture.slopes
    rows, columns = np.mgrid[:32, :32]
    small = 0.5 + 0.2 * np.sin(2.0 * np.pi * columns / 8.0) * np.cos(2.0 * np.pi * rows / 8.0)
    png(tmp_path / "a_Displacement.png", small[:, :, None])
    found = read_foreign(tmp_path).texture.slopes
    inside = slice(16, -16)
    off = (found - whole)[:, inside, inside]
    assert np.square(off).mean() < 4e-3 * np.square(whole[:, inside, inside]).mean()


def test_impossible_albedo_is_clipped_and_noted(plain):
    folder, _, expected = plain
    (folder / "a_Color.png").unlink()
    light = np.moveaxis(expected.diffuse, 0, -1).copy()
    light[0, 0], light[0, 1] = 7.0, -1.0
    write_exr(folder / "a_Color.exr", light, half=False)
    found = read_foreign(folder)
    assert found.texture.diffuse.min() == 0.0 and found.texture.diffuse.max() == 1.0
    assert any("clipped" in note for note in found.notes)


def test_files_of_unknown_use_are_named(plain):
    folder, pictures, _ = plain
    png(folder / "a_xyz.png", pictures["rough"])
    assert any("a_xyz.png" in note for note in read_foreign(folder).notes)
    (folder / "a_Color.png").rename(folder / "a_quux.png")
    with pytest.raises(MatcapError, match="a_quux.png"):
        read_foreign(folder)


def test_channels_of_no_known_name_are_refused_rather_than_guessed(plain):
    folder, pictures, _ = plain
    plane = pictures["rough"][..., 0]
    (folder / "a_Roughness.png").unlink()
    write_other_exr(folder / "a_Roughness.exr", {"one": plane, "two": plane})
    with pytest.raises(MatcapError, match=r"none of its channels \(one, two\)"):
        read_foreign(folder)
    write_other_exr(folder / "a_Roughness.exr", {"one": plane})
    np.testing.assert_array_equal(read_foreign(folder).texture.roughness[0], plane)


def test_a_metal_without_a_metallic_map_is_noted(plain):
    folder, _, _ = plain
    assert not any("metal" in note for note in read_foreign(folder).notes)
    (folder / "a_Color.png").rename(folder / "Rusty_Metal03_Color.png")
    assert any("read as dielectric" in note for note in read_foreign(folder).notes)


def test_a_file_name_overrides_the_option_with_a_note(plain):
    folder, _, expected = plain
    found = read_foreign(folder, normal="dx")
    np.testing.assert_array_equal(found.texture.slopes, expected.slopes)
    assert any("its name says gl" in note for note in found.notes)


# What matcap exports it reads back as a map set.

MAPS = bumpy(48, 32, seed=7, relief=0.05)
MAPS = replace(MAPS, specular=0.0 * MAPS.specular + 0.045)
# The nearest that each can say differs by what its own shading is off from matcap's.
EXACT = ("raw", "polyhaven", "ambientcg", "blender", "mitsuba", "materialx")
SHADED = ("usd", "unreal", "unity-hdrp", "unity-urp", "gltf-textures", "godot", "substance")


@pytest.mark.parametrize("target", EXACT + SHADED)
def test_exports_are_read_back(tmp_path, target):
    write_export(ExportJob(MAPS, "leather"), target, tmp_path)
    found, whole = read_foreign(tmp_path).texture, Texture.from_maps(MAPS)
    colour = 0.004 if target in EXACT else 0.05
    np.testing.assert_allclose(found.diffuse, whole.diffuse, atol=colour)
    np.testing.assert_allclose(found.roughness, whole.roughness, atol=colour)
    np.testing.assert_allclose(found.specular.mean(0), whole.specular[0], atol=0.02)
    np.testing.assert_allclose(found.slopes, whole.slopes, atol=0.02)
    np.testing.assert_allclose(found.height, whole.height, atol=1e-4)
    assert found.texel_size == pytest.approx(whole.texel_size) and found.periodic == whole.periodic


@pytest.mark.parametrize("container", ["jpg", "exr"])
def test_exports_of_every_format_are_read_back(tmp_path, container):
    options = ExportOptions(container=container)
    write_export(ExportJob(MAPS, "leather", options=options), "polyhaven", tmp_path)
    found, whole = read_foreign(tmp_path).texture, Texture.from_maps(MAPS)
    np.testing.assert_allclose(found.specular, whole.specular, atol=0.01)
    assert np.abs(found.diffuse - whole.diffuse).mean() < 0.01
    np.testing.assert_allclose(found.height, whole.height, atol=1e-3)


def test_lengths_in_millimetres_are_read_back(tmp_path):
    write_export(ExportJob(MAPS, "leather", millimetres=40.0,
                           provenance={"millimetres_per_unit": 40.0}), "raw", tmp_path)  # fmt: skip
    found = read_foreign(tmp_path).texture
    assert found.texel_size == pytest.approx(MAPS.texel_size)
    np.testing.assert_allclose(found.height, MAPS.height, atol=1e-5)


def test_a_damaged_sidecar_is_noted(tmp_path):
    write_export(ExportJob(MAPS, "leather"), "raw", tmp_path)
    sidecar = tmp_path / "leather_raw.json"
    sidecar.write_text(sidecar.read_text().replace('"texel": ', '"texel": -'))
    with pytest.raises(MatcapError, match="description is damaged"):
        read_foreign(tmp_path)


def test_a_sidecar_of_another_version_or_without_one_is_noted(tmp_path):
    write_export(ExportJob(MAPS, "leather"), "godot", tmp_path)
    sidecar = tmp_path / "leather_godot.json"
    stated = sidecar.read_text()
    sidecar.write_text(stated.replace('"version": 2', '"version": 3'))
    with pytest.raises(MatcapError, match="version 3, this matcap reads 2"):
        read_foreign(tmp_path)
    sidecar.write_text(stated[:100])
    with pytest.warns(Note, match="not readable as JSON"):
        by_names = read_foreign(tmp_path)
    assert by_names.files["roughness"] == "leather_orm.png"


def test_textures_inside_of_a_glb_are_refused(tmp_path):
    write_export(ExportJob(MAPS, "leather"), "gltf", tmp_path)
    with pytest.raises(MatcapError, match="inside its .glb"):
        read_foreign(tmp_path)


# Kinds of maps that other programs write beside these.


def test_specular_beside_a_diffuse_map_is_f0(plain):
    """Diffuse, coloured specular, roughness and normal, as in papers: specular is F0."""
    folder, pictures, texture = plain
    (folder / "a_Color.png").rename(folder / "a_diffuse.png")
    for file in folder.glob("a_Metal*"):
        file.unlink()
    f0 = np.full((*pictures["base"].shape[:2], 3), (0.9, 0.6, 0.3), np.float32)
    png(folder / "a_specular.png", srgb_picture(f0))
    read = read_foreign(folder)
    np.testing.assert_allclose(read.texture.specular[:, 3, 3], (0.9, 0.6, 0.3), atol=1e-3)
    assert any("read as F0" in note for note in read.notes)


def test_normals_of_object_space_are_refused(plain):
    """By name, and by their look: of a sphere, and of a plane that faces +y."""
    folder, _, _ = plain
    next(folder.glob("a_Normal*")).rename(folder / "a_NormalOS.png")
    with pytest.raises(MatcapError, match=r"object or world space \(a_NormalOS"):
        read_foreign(folder)
    (folder / "a_NormalOS.png").unlink()
    sphere = np.random.default_rng(3).normal(size=(32, 32, 3))
    sphere /= np.linalg.norm(sphere, axis=2, keepdims=True)
    wall = np.zeros((32, 32, 3)) + (0.0, 1.0, 0.05)
    for normals in (sphere, wall):
        png(folder / "a_NormalGL.png", (0.5 + 0.5 * normals).astype(np.float32))
        with pytest.raises(MatcapError, match="object or world space"):
            read_foreign(folder)


def test_occlusion_in_the_blue_of_a_normal_map_is_not_z(plain):
    folder, _, _ = plain
    before = read_foreign(folder).texture.slopes
    file = next(folder.glob("a_Normal*"))
    codes = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    largest = np.iinfo(codes.dtype).max
    occlusion = np.random.default_rng(4).uniform(0.3, 1.0, codes.shape[:2])
    codes[..., 0] = (occlusion * largest).astype(codes.dtype)
    cv2.imwrite(str(file), codes)
    read = read_foreign(folder)
    assert any("blue holds other data" in note for note in read.notes)
    np.testing.assert_allclose(read.texture.slopes, before, atol=0.02)


def test_maps_in_a_subfolder_are_pointed_out(plain):
    folder, _, _ = plain
    inside = folder / "textures"
    inside.mkdir()
    for file in folder.glob("*.png"):
        file.rename(inside / file.name)
    with pytest.raises(MatcapError, match=r"give the folder that holds it \(textures\)"):
        read_foreign(folder)


def test_udim_tiles_of_other_programs_are_refused_by_name(plain):
    folder, _, _ = plain
    for file in list(folder.glob("*.png")):
        for tile in (1001, 1002):
            (folder / f"{file.stem}.{tile}.png").write_bytes(file.read_bytes())
        file.unlink()
    with pytest.raises(MatcapError, match="are UDIM tiles"):
        read_foreign(folder)
    for file in folder.glob("*.1002.png"):
        file.unlink()
    read_foreign(folder)
