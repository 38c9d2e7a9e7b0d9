"""Python can do what `matcap synth` does."""

import json

import pytest
import torch

from matcap.brdf.folder import read_mapset
from matcap.errors import UsageError
from matcap.field.plane import Rectangle
from matcap.synth.request import SynthRequest
from matcap.synth.synthesise import synthesise


def test_a_request_is_written_as_the_field_reads(material, tmp_path):
    asked = SynthRequest(material, Rectangle(-20, 7, 48, 32), seed=3)
    file = synthesise(asked, tmp_path / "set")
    maps, document = read_mapset(file)
    expected = material.maps(48, 32, seed=3, x=-20, y=7)
    torch.testing.assert_close(maps.height, expected.height)
    assert (document["name"], document["seed"]) == (material.name, 3)
    assert (document["x"], document["y"]) == (-20, 7)


@pytest.mark.parametrize(
    ("tile", "period"), [("both", [64, 32]), ("x", [64, None]), ("y", [None, 32])]
)
def test_what_repeats_is_the_whole_of_what_is_written(material, tmp_path, tile, period):
    area = Rectangle(0, 0, 32, 32)
    asked = SynthRequest(material, area, name="two", udim=(2, 1), tile=tile)
    document = json.loads(synthesise(asked, tmp_path / "set").read_text())
    assert document["name"] == "two" and document["period"] == period


def test_a_seed_out_of_range_is_a_usage_error(material, tmp_path):
    with pytest.raises(UsageError, match="out of range"):
        synthesise(SynthRequest(material, Rectangle(0, 0, 8, 8), seed=2**63), tmp_path / "set")
    assert list(tmp_path.iterdir()) == []
