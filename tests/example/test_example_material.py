"""A material that holds an exemplar, beside those of before: opened, read, blended, told of."""

import filecmp
import json
import pickle
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from exemplars import a_coloured_example, an_example, blobs, ordered
from materials import a_material

from matcap.brdf.folder import read_mapset
from matcap.brdf.maps import SURFACE, with_colour
from matcap.cli.main import main
from matcap.errors import UsageError
from matcap.example.example import Example, ExampleSource
from matcap.field.field import read_source
from matcap.field.material import Material
from matcap.field.plane import Rectangle
from matcap.synth.blend import blend_source
from matcap.synth.mask import Mask

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


@pytest.mark.parametrize("other", [lambda: Example.of(blobs(seed=7)), a_coloured_example])
def test_one_field_by_example_grows_into_another(first, other):
    """An exemplar whose F0 has a colour makes the grey one's three channels, too."""
    second = a_material("second", example=other())
    coloured = other is a_coloured_example
    mask = Mask(np.array([[0, 0, 0, 255, 255, 255]], np.uint8), Rectangle(0, 0, 600, 64))
    source = blend_source(first, second, mask, 4)
    assert isinstance(source.source, ExampleSource) and isinstance(source.second, ExampleSource)
    assert source.specular_channels == (3 if coloured else 1)
    area = Rectangle(0, 0, 600, 64)
    maps = read_source(source, area, 1).stacked()
    ends = [read_source(m.part(Example).source(4), area, 1).stacked() for m in (first, second)]
    ends = [with_colour(one) if coloured else one for one in ends]
    for alone, columns in zip(ends, (slice(0, 200), slice(400, 600)), strict=True):
        assert torch.allclose(maps[..., columns], alone[..., columns], atol=1e-6)
    # Between, each texel lies between the two, and the border is no step in height.
    between = slice(240, 360)
    low, high = (end(*ends)[SURFACE, :, between] for end in (torch.minimum, torch.maximum))
    assert bool((maps[SURFACE, :, between] >= low - 1e-6).all())
    assert bool((maps[SURFACE, :, between] <= high + 1e-6).all())
    steps = maps[-1].diff(dim=1).abs()
    assert steps[:, between].max() < 1.5 * steps[:, :200].max()


def test_blends_by_example_are_the_same_bits_however_they_are_read(first, second):
    pixels = np.random.default_rng(1).integers(0, 256, (7, 9)).astype(np.uint8)
    source = blend_source(first, second, Mask(pixels, Rectangle(-100, 0, 800, 300)), 4)
    whole = read_source(source, Rectangle(-60, 20, 300, 280), 2).stacked()
    part = read_source(source, Rectangle(100, 100, 130, 190), 1).stacked()
    assert torch.equal(part, whole[:, 80:270, 160:290])


def test_a_blend_with_a_material_of_before_is_the_decoders(first, second):
    mask = Mask(np.zeros((1, 1), np.uint8), Rectangle(0, 0, 64, 64))
    plain = a_material("plain", seed=5)
    for others in ((first, plain), (plain, second)):
        source = blend_source(*others, mask, 4)
        assert not isinstance(source.source, ExampleSource)
        assert not isinstance(source.second, ExampleSource)
    decoders = blend_source(first, second, mask, 4, generator="decoder")
    assert not isinstance(decoders.source, ExampleSource)
    with pytest.raises(UsageError, match="no exemplar"):
        blend_source(first, plain, mask, 4, generator="example")


def test_the_command_grows_one_into_another(first, second, tmp_path):
    for material in (first, second):
        material.save(tmp_path / f"{material.name}.matcap")
    cv2.imwrite(str(tmp_path / "mask.png"), np.array([[0, 255]], np.uint8))
    words = [str(tmp_path / "first.matcap"), "--blend", str(tmp_path / "second.matcap")]
    words += ["--mask", str(tmp_path / "mask.png"), "--size", "96x32", "--seed", "4", "-q"]
    assert main(["synth", *words, "-o", str(tmp_path / "set")]) == 0
    maps, document = read_mapset(tmp_path / "set")
    assert document["provenance"]["blend"] == ["first", "second"]
    alone = first.maps(8, 32, seed=4).diffuse
    torch.testing.assert_close(maps.diffuse[..., :8], alone, atol=1e-3, rtol=0.0)
    assert main(["synth", *words, "--generator", "decoder", "-o", str(tmp_path / "other")]) == 0
    assert not read_mapset(tmp_path / "other")[0].diffuse.equal(maps.diffuse)
