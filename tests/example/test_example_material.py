"""A material that holds an exemplar, beside those of before: opened, read, blended, told of."""

import filecmp
import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from exemplars import an_example, blobs, ordered
from materials import a_material

from matcap.cli.main import main
from matcap.errors import UsageError
from matcap.example.example import Example
from matcap.field.material import Material
from matcap.field.plane import Rectangle

BEFORE = Path(__file__).parents[1] / "synth" / "before" / "before.matcap"


@pytest.fixture(scope="module")
def first():
    return a_material("first", example=an_example())


@pytest.fixture(scope="module")
def second():
    return a_material("second", seed=4, example=Example.of(blobs(seed=7)))


def test_a_material_without_an_exemplar_is_its_decoder():
    material = Material.load(BEFORE)
    assert set(material.generators) == {"decoder"}
    assert material.maps(24, 16).height.equal(material.maps(24, 16, generator="decoder").height)
    with pytest.raises(UsageError, match="no exemplar"):
        material.maps(24, 16, generator="example")


def test_a_material_without_an_exemplar_is_synthesised_and_told_of(tmp_path, capsys):
    words = [str(BEFORE), "--size", "32x16", "-q", "-o", str(tmp_path / "set")]
    assert main(["synth", *words]) == 0
    assert main(["synth", *words, "--generator", "example"]) == 2
    capsys.readouterr()
    assert main(["inspect", str(BEFORE)]) == 0
    assert "without an exemplar" in capsys.readouterr().out


def test_an_inspection_tells_what_is_left_out(tmp_path, capsys):
    marked = blobs()
    marked.diffuse[:, 60:84, 60:84] = 0.0
    marked.roughness[:, 60:84, 60:84] = 1.0
    for name, example in (("marked", Example.of(marked)), ("bricks", ordered())):
        a_material(name, example=example).save(tmp_path / f"{name}.matcap")
    files = [str(tmp_path / "marked.matcap"), str(tmp_path / "bricks.matcap")]
    assert main(["inspect", *files, "--json"]) == 0
    one, other = json.loads(capsys.readouterr().out)["materials"]
    assert 0.005 < one["exemplar"]["left_out"] < 0.1 and one["exemplar"]["periods"] == []
    assert one["exemplar"]["size"] == [176, 144]
    assert other["exemplar"]["periods"] == pytest.approx([23.3, 17.1], rel=0.01)
    assert main(["inspect", *files]) == 0
    said = capsys.readouterr().out
    assert f"{100 * one['exemplar']['left_out']:.1f} % stands out" in said
    (tmp_path / "marked.matcap").write_bytes(b"nothing")
    assert main(["inspect", *files]) == 4


def test_a_worker_that_was_sent_the_source_computes_the_same(first):
    source = first.part(Example).source(5, (96, None))
    block = Rectangle(-64, 32, 80, 48)
    again = pickle.loads(pickle.dumps(source))
    assert np.array_equal(again.planes(block, "gl"), source.planes(block, "gl"))
    # What it can make again is not sent along.
    assert len(pickle.dumps(source)) < 1.1 * len(pickle.dumps(replace(first.part(Example))))


def test_files_are_the_same_whoever_writes_them(first, tmp_path):
    first.save(tmp_path / "first.matcap")
    words = ["synth", str(tmp_path / "first.matcap"), "--size", "64x48", "--udim", "2x1", "--mip"]
    words += ["--tile", "x", "--seed", "3", "-q"]
    for workers in ("1", "2"):
        assert main([*words, "-j", workers, "-o", str(tmp_path / workers)]) == 0
    names = sorted(file.name for file in (tmp_path / "1").iterdir())
    assert len(names) == 12
    _, differing, missing = filecmp.cmpfiles(tmp_path / "1", tmp_path / "2", names, shallow=False)
    assert not differing and not missing
