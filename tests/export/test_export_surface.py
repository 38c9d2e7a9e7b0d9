"""The residual of conversions: it sees every way in which a target can be wrong."""

from dataclasses import replace

import pytest
import torch
from exported import MATERIALS
from target_surfaces import every, of_maps, residual

from matcap.brdf.maps import MapSet
from matcap.export.shading import TargetShading
from matcap.export.surface import TargetSurface


@pytest.mark.parametrize("name", MATERIALS)
def test_the_maps_themselves_have_none(made, name):
    off = residual(made[name], of_maps(made[name]))
    assert off.mean == off.worst == 0.0


CHANGES = {
    "diffuse": lambda s: {"diffuse": s.diffuse * 1.1},
    "f0": lambda s: {"f0": s.f0 * 1.5},
    "roughness": lambda s: {"roughness": s.roughness * 1.1},
    "normal": lambda s: {"normal": s.normal * torch.tensor([1.0, -1.0, 1.0])[:, None, None]},
    "f90": lambda s: {"f90": 0.5},
    "separable": lambda s: {"shading": TargetShading(masking="separable")},
    "hammon": lambda s: {"shading": TargetShading(masking="hammon")},
    "disney": lambda s: {"shading": TargetShading(diffuse="disney")},
    "index": lambda s: {"shading": TargetShading(index=0.04)},
    "mobile": lambda s: {"shading": TargetShading(specular="mobile")},
    "compensated": lambda s: {"shading": TargetShading(compensated=True)},
    "half": lambda s: {"shading": TargetShading(layer="half"), "layer": s.f0},
    "albedo": lambda s: {"shading": TargetShading(layer="albedo"), "layer": s.f0},
}


@pytest.mark.parametrize("change", CHANGES)
def test_every_parameter_counts(made, change):
    true = of_maps(made["rust"])
    changed = replace(true, **CHANGES[change](true))
    assert residual(made["rust"], changed).worst > 1e-3


def test_a_tenth_more_light_is_a_tenth(made):
    maps = made["leather"]
    black = MapSet(maps.diffuse, 0.0 * maps.specular, maps.roughness, maps.height, 1e9)
    rough = TargetSurface(
        maps.diffuse * 1.1, black.specular, black.roughness, black.normal, f90=0.0
    )
    true = TargetSurface(maps.diffuse, black.specular, black.roughness, black.normal, f90=0.0)
    light = torch.tensor([0.0, 0.6, 0.8], dtype=torch.float64)[:, None, None]
    more, less = (every(s, 1).shine(light, light) for s in (rough, true))
    assert torch.allclose(more, 1.1 * less, rtol=1e-6)


def test_shine_is_the_reflectance_matcap_renders_with(made):
    from matcap.brdf.cook_torrance import cook_torrance, dot

    maps = made["rust"].map(lambda map_: map_.double())
    light = torch.tensor([0.48, 0.36, 0.8], dtype=torch.float64)[:, None, None]
    view = torch.tensor([-0.6, 0.0, 0.8], dtype=torch.float64)[:, None, None]
    full = [v.expand_as(maps.normal) for v in (light, view)]
    expected = cook_torrance(maps.diffuse, maps.specular, maps.roughness, maps.normal, *full) * dot(
        maps.normal, full[0]
    )
    found = of_maps(maps).shine(light, view)
    assert torch.allclose(found, expected.clamp_min(0.0), rtol=1e-6, atol=1e-9)
