"""Python can do what `matcap synth` does."""

import json

import numpy as np
import pytest
import torch

from matcap.brdf.folder import read_mapset
from matcap.errors import UsageError
from matcap.field.plane import Rectangle
from matcap.files.png import write_png
from matcap.synth.request import MaskedBlend, SynthRequest
from matcap.synth.synthesise import synthesise


def test_a_request_is_written_as_the_field_reads(material, tmp_path):
    lines = []
    asked = SynthRequest(material, Rectangle(-20, 7, 48, 32), seed=3)
    file = synthesise(asked, tmp_path / "set", on_precision=lines.append)
    maps, document = read_mapset(file)
    expected = material.maps(48, 32, seed=3, x=-20, y=7)
    torch.testing.assert_close(maps.height, expected.height)
    assert (document["name"], document["seed"]) == (material.name, 3)
    assert (document["x"], document["y"]) == (-20, 7)
    assert [choice.name for choice in lines] == ["fp32"]


@pytest.mark.parametrize(
    ("tile", "period"), [("both", [64, 32]), ("x", [64, None]), ("y", [None, 32])]
)
def test_what_repeats_is_the_whole_of_what_is_written(material, tmp_path, tile, period):
    area = Rectangle(0, 0, 32, 32)
    asked = SynthRequest(material, area, name="two", udim=(2, 1), tile=tile)
    document = json.loads(synthesise(asked, tmp_path / "set").read_text())
    assert document["name"] == "two" and document["period"] == period


def test_it_grows_where_the_mask_is_white(material, make_material, tmp_path):
    mask = tmp_path / "mask.png"
    write_png(mask, np.repeat(np.array([[0.0, 1.0]], dtype=np.float32), 2, axis=0), bits=8)
    other = make_material("other", seed=4)
    area = Rectangle(0, 0, 96, 32)
    asked = SynthRequest(material, area, blend=MaskedBlend(other, mask, Rectangle(0, 0, 96, 32)))
    maps, document = read_mapset(synthesise(asked, tmp_path / "set"))
    assert document["provenance"]["blend"] == [material.name, "other"]
    assert document["provenance"]["mask_over"] == [0, 0, 96, 32]
    torch.testing.assert_close(
        maps.diffuse[..., :8], material.maps(8, 32).diffuse, atol=1e-3, rtol=0.0
    )


def test_a_seed_out_of_range_is_a_usage_error(material, tmp_path):
    with pytest.raises(UsageError, match="out of range"):
        synthesise(SynthRequest(material, Rectangle(0, 0, 8, 8), seed=2**63), tmp_path / "set")
    assert list(tmp_path.iterdir()) == []
