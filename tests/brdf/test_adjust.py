"""What each adjustment means; what is refused; and that commands keep to it."""

import json

import numpy as np
import pytest
import torch

from matcap.brdf.adjust import NONE, Adjustments, adjusted, adjusted_planes, parse_adjustments
from matcap.brdf.folder import MapSetInfo, read_mapset, write_mapset
from matcap.brdf.maps import MapSet
from matcap.cli.main import main
from matcap.errors import UsageError

_GREY = np.array([0.2126, 0.7152, 0.0722])


@pytest.fixture
def maps():
    stacked = 0.2 + 0.6 * torch.rand(6, 12, 16, generator=torch.Generator().manual_seed(1))
    stacked[5] *= 0.01
    return MapSet.from_stacked(stacked, 2 / 512, periodic=True)


def test_no_adjustment_is_the_identity(maps):
    assert adjusted(maps, NONE) is maps
    assert adjusted(maps, parse_adjustments("relief=1,roughness=0,tint=#ffffff")) is maps


def test_relief_scales_slopes_exactly(maps):
    found = adjusted(maps, Adjustments(relief=1.75))
    before, after = (-m.normal[:2] / m.normal[2:] for m in (maps, found))
    torch.testing.assert_close(after, 1.75 * before, rtol=2e-5, atol=1e-4)
    assert torch.equal(found.height, maps.height * 1.75)
    assert torch.equal(found.stacked()[:5], maps.stacked()[:5])
    assert found.periodic and found.texel_size == maps.texel_size


def test_normals_that_come_along_are_those_of_the_new_height(maps):
    planes = torch.cat([maps.stacked(), maps.normal]).numpy()
    found = adjusted_planes(planes, Adjustments(relief=0.3))
    wanted = adjusted(maps, Adjustments(relief=0.3)).normal.numpy()
    np.testing.assert_allclose(found[6:9], wanted, atol=1e-6)


def test_no_relief_is_flat(maps):
    normal = adjusted(maps, Adjustments(relief=0.0)).normal
    assert torch.equal(normal, torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand_as(normal))


@pytest.mark.parametrize("change", [-0.15, 0.2, 1.0])
def test_roughness_is_added_within_its_range(maps, change):
    found = adjusted(maps, Adjustments(roughness=change))
    assert torch.equal(found.roughness, (maps.roughness + change).clamp(0.0, 1.0))
    assert torch.equal(found.height, maps.height)


def test_saturation_keeps_luminance(maps):
    grey = adjusted(maps, Adjustments(saturation=0.0)).diffuse.numpy()
    luminance = np.tensordot(_GREY, maps.diffuse.numpy(), 1)
    for channel in grey:
        np.testing.assert_allclose(channel, luminance, atol=1e-6)
    half = adjusted(maps, Adjustments(saturation=0.5)).diffuse.numpy()
    np.testing.assert_allclose(half, (grey + maps.diffuse.numpy()) / 2, atol=1e-6)


def test_brightness_is_a_factor_up_to_white(maps):
    found = adjusted(maps, Adjustments(brightness=2.0))
    torch.testing.assert_close(found.diffuse, (2.0 * maps.diffuse).clamp(0.0, 1.0))
    assert torch.equal(found.specular, maps.specular)


def test_a_tint_is_a_colour_of_luminance_one(maps):
    colour = Adjustments(tint="#ffc080").colour.diagonal()
    assert float(colour @ _GREY) == pytest.approx(1.0, abs=1e-6)
    assert colour[0] > colour[1] > colour[2]
    found = adjusted(maps, Adjustments(tint="#ffc080", brightness=0.5)).diffuse
    wanted = maps.diffuse * torch.from_numpy(colour.copy())[:, None, None] * 0.5
    torch.testing.assert_close(found, wanted.clamp(0.0, 1.0))


@pytest.mark.parametrize(
    "text", ["relief=1.3,roughness=-0.1", "tint=#ffe8d0", "saturation=0,brightness=0.25", ""]
)
def test_written_adjustments_are_read_back(text):
    one = parse_adjustments(text)
    assert parse_adjustments(one.text) == one
    assert (one.text == "") == (text == "") == (not one.changes)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("relief", "is not an adjustment"),
        ("shine=2", "a name of relief, roughness"),
        ("relief=2,relief=3", "twice"),
        ("relief=much", "give a number"),
        ("relief=nan", "give a number"),
        ("relief=-1", "from 0 to 10"),
        ("roughness=1.01", "from -1 to 1"),
        ("brightness=inf", "give a number"),
        ("tint=red", "a colour other than black"),
        ("tint=#000000", "a colour other than black"),
        ("relief=1,,", "is not an adjustment"),
        ("nowhere.json", "no adjustments"),
    ],
)
def test_malformed_adjustments_are_one_sentence(text, says):
    with pytest.raises(UsageError, match=says) as raised:
        parse_adjustments(text)
    assert "\n" not in str(raised.value) and len(str(raised.value)) < 200


def test_synth_adjusts_its_maps_and_records_it(tmp_path, capsys):
    from materials import a_material

    file = tmp_path / "tiny.matcap"
    a_material().save(file)
    before = file.read_bytes()
    given = "relief=1.5,roughness=0.1,saturation=0.5"
    common = ["synth", str(file), "--size", "48x32", "-q"]
    assert main([*common, "-o", str(tmp_path / "plain")]) == 0
    assert main([*common, "--adjust", given, "-o", str(tmp_path / "other")]) == 0
    assert file.read_bytes() == before
    plain, _ = read_mapset(tmp_path / "plain")
    other, document = read_mapset(tmp_path / "other")
    assert document["provenance"]["adjust"] == given
    wanted = adjusted(plain, parse_adjustments(given))
    # Both were stored as half floats, once before and once after.
    torch.testing.assert_close(other.stacked(), wanted.stacked(), rtol=2e-3, atol=1e-3)
    # A sidecar can be given in place of what it says.
    sidecar = str(tmp_path / "other" / "tiny.json")
    assert main([*common, "--adjust", sidecar, "-o", str(tmp_path / "again")]) == 0
    again, _ = read_mapset(tmp_path / "again")
    assert torch.equal(again.stacked(), other.stacked())
    assert main([*common, "--adjust", "shine=1"]) == 2 and capsys.readouterr().err.count("\n") == 1


def test_export_and_relight_adjust(tmp_path, maps):
    write_mapset(maps, tmp_path / "maps", MapSetInfo("wall"))
    given = "brightness=0.5,relief=2"
    changed = adjusted(read_mapset(tmp_path / "maps")[0], parse_adjustments(given))
    write_mapset(changed, tmp_path / "changed", MapSetInfo("wall"))
    for name, where, more in (("a", "maps", ["--adjust", given]), ("b", "changed", [])):
        picture = str(tmp_path / f"{name}.exr")
        assert main(["relight", str(tmp_path / where), "-o", picture, "-q", *more]) == 0
        out = str(tmp_path / name)
        assert main(["export", str(tmp_path / where), "--to", "raw", "-o", out, "-q", *more]) == 0
    from matcap.files.exr import read_exr

    lit = [read_exr(tmp_path / f"{name}.exr").pixels for name in "ab"]
    np.testing.assert_allclose(lit[0], lit[1], rtol=5e-3, atol=1e-4)
    sidecar = json.loads((tmp_path / "a" / "wall_raw.json").read_text())
    assert sidecar["provenance"]["adjust"] == "relief=2,brightness=0.5"
