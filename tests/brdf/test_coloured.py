"""F0 with a colour: three channels where some of a material is metal, one everywhere else."""

import json
from dataclasses import replace

import cv2
import numpy as np
import OpenEXR
import pytest
import torch
from random_maps import random_maps

from matcap.brdf.adjust import Adjustments, adjusted, adjusted_planes
from matcap.brdf.folder import MapSetInfo, read_mapset, write_mapset
from matcap.brdf.maps import DIFFUSE, HEIGHT, ROUGHNESS, SPECULAR, SURFACE, MapSet, with_colour
from matcap.brdf.parameters import SurfaceParameters
from matcap.errors import MatcapError
from matcap.flash.geometry import FlashSetup
from matcap.flash.render import render_rectified

INFO = MapSetInfo("gold", seed=1)
LUMINANCE = torch.tensor([0.2126, 0.7152, 0.0722])


def drawn(channels: int) -> MapSet:
    return random_maps(12, 9, channels, texel_size=2 / 512, channels=channels, low=0.2, high=0.8)


@pytest.mark.parametrize("channels", [1, 3])
def test_stacking_keeps_every_map_in_its_place(channels):
    maps = drawn(channels)
    stacked = maps.stacked()
    places = {"diffuse": DIFFUSE, "specular": SPECULAR, "roughness": ROUGHNESS, "height": HEIGHT}
    assert all(torch.equal(stacked[place], getattr(maps, n)) for n, place in places.items())
    assert torch.equal(stacked[SURFACE], torch.cat([*(stacked[p] for p in places.values())][:3]))
    back = SurfaceParameters.from_stacked(SurfaceParameters.of(maps).stacked()).maps(
        maps.texel_size
    )
    assert len(back.specular) == channels
    assert torch.allclose(back.stacked(), stacked, atol=1e-5)


def test_two_channels_are_no_colour():
    with pytest.raises(ValueError, match="specular"):
        drawn(2)


def test_three_equal_channels_shine_as_one():
    grey = drawn(1)
    setup = FlashSetup(fov=45.0)
    coloured = replace(grey, specular=grey.specular.expand(3, -1, -1))
    pictures = (render_rectified(maps, setup) for maps in (grey, coloured))
    assert torch.allclose(*pictures, rtol=1e-6)


def test_each_channel_mirrors_by_itself():
    metal = drawn(3)
    setup = FlashSetup(fov=45.0)
    whole = render_rectified(metal, setup)
    for channel in range(3):
        alone = replace(metal, specular=metal.specular[channel : channel + 1])
        assert torch.allclose(render_rectified(alone, setup)[channel], whole[channel], rtol=1e-6)


@pytest.mark.parametrize("channels", [1, 3])
def test_a_folder_gives_back_as_many_channels(tmp_path, channels):
    maps = drawn(channels)
    document = json.loads(write_mapset(maps, tmp_path, INFO).read_text())
    found, _ = read_mapset(tmp_path)
    assert torch.equal(found.specular, maps.specular.half().float())
    assert torch.equal(found.diffuse, maps.diffuse.half().float())
    # Files of sets without a colour are as they were before there was any.
    assert document.get("specular_channels") == (3 if channels == 3 else None)
    assert ("Rec.709" in document["maps"]["specular"]["meaning"]) == (channels == 3)


def test_pictures_are_red_green_and_blue(tmp_path):
    maps = drawn(3)
    write_mapset(maps, tmp_path, INFO, png=True)
    (rgb,) = OpenEXR.File(str(tmp_path / "gold_specular.exr")).channels().values()
    assert np.array_equal(rgb.pixels, maps.specular.movedim(0, -1).half().numpy())
    png = cv2.imread(str(tmp_path / "gold_specular.png"), cv2.IMREAD_UNCHANGED)[..., ::-1]
    assert np.abs(png / 65535.0 - maps.specular.movedim(0, -1).numpy()).max() < 1e-5


@pytest.mark.parametrize(
    ("channels", "stated", "said"),
    [(3, None, "3 channels instead of 1"),
     (3, 2, "neither 1 nor 3"), (3, True, "neither 1 nor 3"), (3, "3", "neither 1 nor 3")],
)  # fmt: skip
def test_what_is_stated_and_what_is_there_must_agree(tmp_path, channels, stated, said):
    file = write_mapset(drawn(channels), tmp_path, INFO)
    document = json.loads(file.read_text())
    document.pop("specular_channels", None)
    if stated is not None:
        document["specular_channels"] = stated
    file.write_text(json.dumps(document))
    with pytest.raises(MatcapError, match=said) as refused:
        read_mapset(tmp_path)
    if "instead" in said:
        # An editor may have added a colour: what it says to do mends that.
        assert f'"specular_channels": {channels}' in refused.value.remedy
        file.write_text(json.dumps(document | {"specular_channels": channels}))
        assert len(read_mapset(tmp_path)[0].specular) == channels


def test_grey_becomes_three_equal_channels():
    grey = drawn(1)
    found = MapSet.from_stacked(with_colour(grey.stacked()), grey.texel_size)
    assert torch.equal(found.specular, grey.specular.expand(3, -1, -1))
    for kind in ("diffuse", "roughness", "height"):
        assert torch.equal(getattr(found, kind), getattr(grey, kind))
    assert with_colour(found.stacked()).shape == found.stacked().shape


def test_without_saturation_a_metal_is_grey_of_its_luminance():
    maps = drawn(3)
    found = adjusted(maps, Adjustments(saturation=0.0))
    luminance = (LUMINANCE[:, None, None] * maps.specular).sum(0)
    torch.testing.assert_close(found.specular, luminance.expand(3, -1, -1))
    # A tint and a brightness are of diffuse albedo alone.
    tinted = adjusted(maps, Adjustments(tint="#ff8040", brightness=0.5))
    assert torch.equal(tinted.specular, maps.specular)


@pytest.mark.parametrize("normal", [False, True])
@pytest.mark.parametrize("channels", [1, 3])
def test_gloss_and_relief_meet_their_own_planes(channels, normal):
    maps = drawn(channels)
    count = 5 + channels
    planes = torch.cat([maps.stacked(), maps.normal]) if normal else maps.stacked()
    found = adjusted_planes(planes.numpy(), Adjustments(relief=2.0, roughness=0.1))
    stacked = found[:count]
    assert np.array_equal(stacked[HEIGHT], 2.0 * maps.height.numpy())
    np.testing.assert_allclose(stacked[ROUGHNESS], maps.roughness.numpy() + 0.1, rtol=1e-6)
    assert np.array_equal(stacked[SPECULAR], maps.specular.numpy())
    wanted = adjusted(maps, Adjustments(relief=2.0)).normal.numpy()
    if normal:
        np.testing.assert_allclose(found[count:], wanted, atol=1e-6)


def test_painted_normals_of_a_metal_are_adjusted_too():
    maps = drawn(3)
    painted = replace(maps, painted=maps.normal)
    found = adjusted(painted, Adjustments(relief=0.5))
    assert len(found.specular) == 3
    torch.testing.assert_close(
        found.painted, adjusted(maps, Adjustments(relief=0.5)).normal, atol=1e-6, rtol=0.0
    )
