"""F0 with a colour: three channels where some of a material is metal, one everywhere else."""

from dataclasses import replace

import pytest
import torch

from matcap.brdf.maps import DIFFUSE, HEIGHT, ROUGHNESS, SPECULAR, SURFACE, MapSet
from matcap.brdf.parameters import SurfaceParameters
from matcap.flash.geometry import FlashSetup
from matcap.flash.render import render_rectified


def drawn(channels: int) -> MapSet:
    values = torch.rand(5 + channels, 9, 12, generator=torch.Generator().manual_seed(channels))
    return MapSet.from_stacked(values * 0.9 + 0.05, 0.1)


@pytest.mark.parametrize("channels", [1, 3])
def test_stacking_keeps_every_map_in_its_place(channels):
    maps = drawn(channels)
    stacked = maps.stacked()
    places = {"diffuse": DIFFUSE, "specular": SPECULAR, "roughness": ROUGHNESS, "height": HEIGHT}
    assert all(torch.equal(stacked[place], getattr(maps, n)) for n, place in places.items())
    assert torch.equal(stacked[SURFACE], torch.cat([*(stacked[p] for p in places.values())][:3]))
    back = SurfaceParameters.from_stacked(SurfaceParameters.of(maps).stacked()).maps(0.1)
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
