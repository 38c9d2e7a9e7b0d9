"""Exemplars, their material files and coloured F0."""

import filecmp
import json
import pickle
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from exemplars import a_coloured_example, an_example, blobs, coloured, ordered, reread
from materials import a_material

from matcap.brdf.folder import read_mapset
from matcap.cli.main import main
from matcap.errors import UsageError
from matcap.example.candidates import choose_scale, features_of, planes_of
from matcap.example.example import Example
from matcap.example.exemplar import SPECULAR, Exemplar
from matcap.example.repeat import flatten
from matcap.field.field import read_source
from matcap.field.material import Material
from matcap.field.plane import Grid, Rectangle

# An exemplar survives its file, and a broken file is told from a whole one.


def an_exemplar(width=70, height=40, seed=1):
    random = np.random.default_rng(seed)
    shares = random.random((9, height, width), np.float32)
    return Exemplar(
        diffuse=shares[:3],
        specular=shares[3:4],
        roughness=shares[4:5],
        height=0.02 * random.standard_normal((1, height, width)).astype(np.float32) + 3.0,
        confidence=shares[5:],
        texel_size=2 / 1024,
    )


def same(first, second):
    return all(
        np.array_equal(getattr(first, one.name), getattr(second, one.name))
        for one in fields(Exemplar)
    )


def test_a_file_reads_back_the_rounded_maps():
    exemplar = an_exemplar()
    assert same(reread(exemplar), exemplar.rounded())
    assert same(exemplar.rounded().rounded(), exemplar.rounded())
    assert not same(exemplar, exemplar.rounded())


def test_rounding_is_finer_than_what_is_seen():
    exemplar = an_exemplar()
    rounded = exemplar.rounded()
    spread = float(np.ptp(exemplar.height))
    assert np.abs(rounded.height - exemplar.height).max() <= spread / 2**15
    # To the nearest, which no direction is preferred by.
    unit = 2.0 ** (exemplar.stored()[1]["height_unit"] - 1)
    off = (rounded.height.astype(np.float64) - exemplar.height) / unit
    assert np.abs(off).max() <= 0.55 and abs(off.mean()) < 0.05
    assert np.abs(rounded.diffuse - exemplar.diffuse).max() <= 2**-11
    assert np.abs(rounded.confidence - exemplar.confidence).max() <= 0.5 / 15 + 1e-6


@pytest.mark.parametrize("height", [0.0, -7.5, 1e4])
def test_a_flat_exemplar_stays_flat(height):
    flat = replace(an_exemplar(), height=np.full((1, 40, 70), height, np.float32))
    assert np.ptp(reread(flat).height) == 0.0
    assert reread(flat).height[0, 0, 0] == pytest.approx(height, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("diffuse", np.zeros((3, 40, 71), np.float32)),
        ("diffuse", np.zeros((3, 40, 70), np.float64)),
        ("roughness", np.full((1, 40, 70), 1.5, np.float32)),
        ("height", np.full((1, 40, 70), np.nan, np.float32)),
        ("confidence", np.full((4, 40, 70), -0.1, np.float32)),
    ],
)
def test_maps_out_of_shape_or_range_are_refused(name, values):
    with pytest.raises(ValueError, match=name):
        replace(an_exemplar(), **{name: values})


def test_damaged_files_are_refused():
    tensors, about = an_exemplar().stored()

    def read(tensors=tensors, **other):
        return Exemplar.read({**about, **other}, tensors.__getitem__)

    with pytest.raises(ValueError, match="exemplar of"):
        read(size=[10**6, 10**6])
    with pytest.raises(ValueError, match="bytes"):
        read(size=[70, 41])
    with pytest.raises(ValueError, match="bytes"):
        read(size=[70, 39])
    with pytest.raises(ValueError, match="unpacked|bytes"):
        read(tensors | {"diffuse": tensors["diffuse"][:-9]})
    with pytest.raises(ValueError, match="unpacked"):
        read(tensors | {"height": np.zeros(50, np.uint8)})
    with pytest.raises(ValueError, match="heights"):
        read(height_unit=500)
    with pytest.raises(KeyError):
        read({"diffuse": tensors["diffuse"]})


def test_planes_are_contiguous_however_they_are_given():
    """The field's kernel reads each plane by its address."""
    exemplar = an_exemplar()
    interleaved = {
        one.name: np.asfortranarray(getattr(exemplar, one.name))
        for one in fields(Exemplar)
        if one.name != "texel_size"
    }
    stored = replace(exemplar, **interleaved)
    assert same(stored, exemplar)
    assert all(getattr(stored, name).flags.c_contiguous for name in interleaved)


# A material that holds an exemplar, beside those of before: opened, read, blended, told of.

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


def test_a_material_without_an_exemplar_is_synthesised_with_a_note(tmp_path, capsys):
    words = [str(BEFORE), "--size", "32x16", "-q", "-o", str(tmp_path / "set")]
    assert main(["synth", *words]) == 0 and main(["synth", *words, "--generator", "example"]) == 2
    capsys.readouterr()
    assert main(["inspect", str(BEFORE)]) == 0 and "without an exemplar" in capsys.readouterr().out


def test_inspect_states_what_is_left_out(tmp_path, capsys):
    marked = blobs()
    marked.diffuse[:, 60:84, 60:84] = 0.0
    marked.roughness[:, 60:84, 60:84] = 1.0
    for name, example in (("marked", Example.of(marked)), ("bricks", ordered())):
        a_material(name, example=example).save(tmp_path / f"{name}.matcap")
    files = [str(tmp_path / "marked.matcap"), str(tmp_path / "bricks.matcap")]
    (tmp_path / "bricks_diffuse.png").write_bytes(b"no photograph")
    assert main(["inspect", str(tmp_path), "--json"]) == 0
    other, one = json.loads(capsys.readouterr().out)["materials"]
    assert 0.005 < one["exemplar"]["left_out"] < 0.1 and one["exemplar"]["periods"] == []
    assert one["exemplar"]["size"] == [176, 144]
    assert other["exemplar"]["periods"] == pytest.approx([23.3, 17.1], rel=0.01)
    assert main(["inspect", *files]) == 0
    assert f"{100 * one['exemplar']['left_out']:.1f} % stands out" in capsys.readouterr().out
    (tmp_path / "marked.matcap").write_bytes(b"nothing")
    assert main(["inspect", *files]) == 4


def test_a_pickled_source_computes_the_same_bits(first):
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


# An exemplar whose F0 has a colour: stored, compared by it, rearranged, repeated and written.

AREA = Rectangle(-30, 20, 150, 90)


def test_three_channels_of_f0_are_read_back():
    exemplar = coloured(blobs())
    found = reread(exemplar)
    assert found.specular.shape == (3, *exemplar.height.shape[1:])
    assert np.array_equal(found.specular, exemplar.rounded().specular)
    assert blobs().stored()[1]["specular_channels"] == 1


def test_channels_that_are_not_there_are_refused_before_they_are_unpacked():
    grey, hue = blobs().stored(), coloured(blobs()).stored()
    for (tensors, about), stated in ((grey, 3), (hue, 1), (grey, 4096), (grey, "3")):
        with pytest.raises(ValueError, match="bytes|neither 1 nor 3"):
            Exemplar.read(about | {"specular_channels": stated}, tensors.__getitem__)


def test_metals_are_compared_by_their_colour():
    """Equal albedo, equal luminance: hue alone tells these two halves apart."""
    piece = blobs()
    high, wide = piece.height.shape[1:]
    half = np.arange(wide) < wide // 2
    black, even = np.zeros_like(piece.diffuse), np.full_like(piece.height, 0.5)
    red = np.array([0.8, 0.4, 0.2], np.float32)
    blue = np.array([0.2, 0.0, 1.0], np.float32)
    weights = np.array([0.2126, 0.7152, 0.0722], np.float32)
    blue[1] = (red @ weights - blue @ weights) / weights[1]
    hue = np.where(half, red[:, None], blue[:, None])[:, None].repeat(high, axis=1)
    metal = replace(piece, diffuse=black, specular=hue, roughness=even, height=0.0 * even)
    planes = planes_of(metal)
    features = features_of(planes, choose_scale(planes))
    assert np.abs(planes[3].std()) < 1e-6
    apart = np.abs(features[:3, :, 0].astype(float) - features[:3, :, -1]).mean(axis=1)
    assert apart.max() > 32  # a standard deviation


def test_a_coloured_f0_leaves_the_compared_grey_planes_as_they_are():
    piece = blobs()
    planes, hue = planes_of(piece), planes_of(coloured(piece))
    assert np.array_equal(planes[:3], np.sqrt(piece.diffuse))
    assert np.array_equal(planes[3], np.sqrt(piece.specular[0]))
    assert np.array_equal(hue[4:], planes[4:])
    np.testing.assert_allclose(hue[3], planes[3], rtol=1e-6)


def test_a_field_has_the_f0_colours_of_its_exemplar():
    example = a_coloured_example()
    maps = example.maps(5, AREA, None)
    assert len(maps) == 8
    places = example.places(5, AREA, None)
    shown = example.exemplar.specular[:, places[..., 1], places[..., 0]]
    for found, own in zip(maps[SPECULAR], shown, strict=True):
        assert np.corrcoef(found.ravel(), own.ravel())[0, 1] > 0.8
    source = replace(example.source(5), grid=Grid(64, 32))
    whole = read_source(source, AREA, 2)
    assert torch.equal(whole.stacked()[:-1], torch.from_numpy(maps[:-1]))
    part = read_source(pickle.loads(pickle.dumps(source)), Rectangle(10, 40, 50, 40), 1)
    assert torch.equal(part.specular, whole.specular[:, 20:60, 40:90])
    planes = source.planes(Rectangle(0, 0, 64, 32), "gl")
    np.testing.assert_allclose(np.square(planes[-3:]).sum(axis=0), 1.0, rtol=1e-5)
    assert np.array_equal(planes[7], example.maps(5, Rectangle(0, 0, 64, 32), None)[-1])


def test_the_tiled_exemplar_keeps_its_f0_colour():
    grey, hue = an_example().repeating(), a_coloured_example().repeating()
    assert len(hue.specular) == 3 and hue.periodic and len(grey.specular) == 1
    exemplar = a_coloured_example().exemplar
    for channel in range(3):
        steps = (hue.specular[channel] - hue.specular[channel].roll(1, 1)).abs().mean(0)
        assert steps[0] <= 1.2 * steps[1:].mean()
        there = exemplar.specular[channel]
        assert float(hue.specular[channel].mean()) == pytest.approx(there.mean(), rel=0.05)


@pytest.mark.parametrize("words", [[], ["--mip", "--png"], ["--tile", "piece"]])
def test_written_maps_keep_the_f0_colour(tmp_path, words):
    path = tmp_path / "gold.matcap"
    material = a_material("gold", example=a_coloured_example())
    material.save(path)
    called = ["synth", str(path), "--seed", "0", *words, "-q", "-j", "1", "-o", str(tmp_path / "o")]
    assert main(called + ([] if "piece" in words else ["--size", "96x64"])) == 0
    found, document = read_mapset(tmp_path / "o")
    expected = material.repeating() if "piece" in words else material.maps(96, 64)
    assert document["specular_channels"] == 3
    assert torch.equal(found.specular, expected.specular.half().float())
    assert torch.equal(found.roughness, expected.roughness.half().float())
    assert torch.equal(found.height, expected.height)
    if "--png" in words:
        import cv2

        png = cv2.imread(str(tmp_path / "o" / "gold_specular.png"), cv2.IMREAD_UNCHANGED)
        assert np.abs(png[..., ::-1] / 65535.0 - expected.specular.movedim(0, -1).numpy()).max() < (
            2**-11
        )


def test_inspect_shows_the_f0_colour(tmp_path, capsys):
    from matcap.capture.preview import each_map

    hue, grey = a_coloured_example(), an_example()
    for name, example in (("hue", hue), ("grey", grey)):
        a_material(name, example=example).save(tmp_path / f"{name}.matcap")
    files = [str(tmp_path / f"{name}.matcap") for name in ("hue", "grey")]
    assert main(["inspect", *files]) == 0
    said = capsys.readouterr().out
    assert said.count("some of it is metal") == 1 and said.count("without a colour") == 1
    assert main(["inspect", *files, "--json"]) == 0
    result = [one["exemplar"]["f0"] for one in json.loads(capsys.readouterr().out)["materials"]]
    assert result[0] == pytest.approx(hue.exemplar.specular.mean((1, 2)), abs=1e-3)
    assert len(result[1]) == 1
    (shown,) = (one for one in each_map(hue.piece()) if one.label.startswith("specular"))
    assert shown.values.shape == (144, 176, 3)
    code = shown.code(shown.values)
    assert np.abs(code[..., 0] - code[..., 2]).max() > 0.05


def test_patches_of_metal_are_not_taken_for_slow_light():
    """Half rust, half metal, more of the one here and of the other there: nothing to level."""
    random = np.random.default_rng(2)
    share = 0.5 + 0.3 * np.sin(np.arange(176) / 28.0)[None, :].repeat(144, axis=0)
    metal = random.random((144, 176)) < share
    planes = [np.where(metal, 0.0, albedo) for albedo in (0.22, 0.085, 0.03)]
    planes += [np.where(metal, f0, 0.04) for f0 in (1.0, 0.766, 0.336)]
    planes += [np.where(metal, 0.3, 0.8), 0.0 * share]
    maps = np.stack(planes).astype(np.float32)
    np.testing.assert_allclose(flatten(maps), maps, atol=1e-5)
    # What is slow in both of them is taken away.
    slope = np.exp(np.linspace(-0.2, 0.2, 176)).astype(np.float32)
    sloped = maps.copy()
    sloped[:6] *= 0.8 * slope
    found = flatten(sloped)
    first, last = (
        found[3, :, some][metal[:, some]].mean() for some in (slice(30), slice(-30, None))
    )
    assert last / first < 1.15 and slope[-15] / slope[15] > 1.3
