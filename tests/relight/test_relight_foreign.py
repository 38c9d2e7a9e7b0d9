"""Map sets of others, written here from a material that is known."""

import cv2
import numpy as np
import pytest
import torch
from relight_samples import bumpy

from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError
from matcap.files.srgb import srgb_picture
from matcap.relight.foreign import read_foreign

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


@pytest.fixture
def maps() -> MapSet:
    return bumpy(64, 64, seed=7, relief=0.05)


def write(path, values):
    """(C, H, W) in [0, 1] as a 16-bit PNG."""
    stored = np.rint(np.moveaxis(values, 0, -1) * 65535).astype(np.uint16)
    cv2.imwrite(str(path), np.ascontiguousarray(stored[..., ::-1]))


def publish(maps, folder, names, kinds, metal=0.0):
    """Write maps the way such sites do."""
    height = maps.height.numpy()
    low, high = height.min(), height.max()
    normal = 0.5 + 0.5 * maps.normal.numpy()
    flipped = normal * [[[1.0]], [[-1.0]], [[1.0]]] + [[[0.0]], [[1.0]], [[0.0]]]
    pictures = {
        "base": srgb_picture(maps.diffuse.numpy()),
        "gl": normal,
        "dx": flipped,
        "rough": maps.roughness.numpy(),
        "height": (height - low) / (high - low),
        "metal": np.full_like(height, metal),
    }
    for kind in kinds:
        write(folder / names.get(kind, kind), pictures[kind.split("/")[-1]])


@pytest.mark.parametrize("names", [AMBIENTCG, POLYHAVEN])
@pytest.mark.parametrize("normal", ["gl", "dx"])
def test_the_usual_names(tmp_path, maps, names, normal):
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
    publish(maps, tmp_path, AMBIENTCG, ["base", "gl", "rough", "metal"], metal=1.0)
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
    half = torch.nn.functional.avg_pool2d(maps.roughness[None], 2)[0].numpy()
    write(tmp_path / "rock_wall_08_arm_1k.png", np.concatenate([half, half, 0 * half]))
    found = read_foreign(tmp_path).texture
    assert found.roughness.shape == (1, 64, 64)
    np.testing.assert_allclose(found.roughness, maps.roughness, atol=0.03)


def test_height_alone_and_nothing_but_colour(tmp_path, maps):
    publish(maps, tmp_path, AMBIENTCG, ["base", "height"])
    found = read_foreign(tmp_path)
    assert np.ptp(found.texture.height) == pytest.approx(0.04, rel=1e-3)
    assert len(found.notes) == 2
    (tmp_path / AMBIENTCG["height"]).unlink()
    assert not read_foreign(tmp_path).texture.height.any()


def test_folders_that_are_no_map_sets(tmp_path, maps):
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
