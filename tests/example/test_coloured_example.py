"""An exemplar whose F0 has a colour: stored, compared by it, rearranged, repeated and written."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch
from exemplars import a_coloured_example, an_example, blobs, coloured, reread
from materials import a_material

from matcap.brdf.folder import read_mapset
from matcap.cli.main import main
from matcap.example.exemplar import SPECULAR, Exemplar
from matcap.example.features import choose_scale, features_of, planes_of
from matcap.example.repeat.flatten import flatten
from matcap.field.blocks import Grid
from matcap.field.field import read_source
from matcap.field.plane import Rectangle

AREA = Rectangle(-30, 20, 150, 90)


def test_a_file_gives_back_three_channels():
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


def test_what_is_no_metal_is_compared_as_it_was():
    piece = blobs()
    planes, hue = planes_of(piece), planes_of(coloured(piece))
    assert np.array_equal(planes[:3], np.sqrt(piece.diffuse))
    assert np.array_equal(planes[3], np.sqrt(piece.specular[0]))
    assert np.array_equal(hue[4:], planes[4:])
    np.testing.assert_allclose(hue[3], planes[3], rtol=1e-6)


def test_a_field_shows_the_exemplars_own_colours_whoever_asks():
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


def test_the_piece_repeats_in_its_colours():
    grey, hue = an_example().repeating(), a_coloured_example().repeating()
    assert len(hue.specular) == 3 and hue.periodic and len(grey.specular) == 1
    exemplar = a_coloured_example().exemplar
    for channel in range(3):
        steps = (hue.specular[channel] - hue.specular[channel].roll(1, 1)).abs().mean(0)
        assert steps[0] <= 1.2 * steps[1:].mean()
        there = exemplar.specular[channel]
        assert float(hue.specular[channel].mean()) == pytest.approx(there.mean(), rel=0.05)


@pytest.mark.parametrize("words", [[], ["--mip", "--png"], ["--tile", "piece"]])
def test_what_is_written_has_its_colour(tmp_path, words):
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


def test_an_inspection_and_a_comparison_show_the_colour(tmp_path, capsys):
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
