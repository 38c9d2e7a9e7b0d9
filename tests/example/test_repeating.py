"""The exemplar made periodic: no seam, no slow drift, whole periods, stains stay in place."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from exemplars import PERIODS, an_example, blobs, exemplar, ordered
from materials import a_material
from simulated.materials import true_exemplar

from matcap.brdf.edited import seam_ratio
from matcap.brdf.folder import read_mapset
from matcap.cli.main import main
from matcap.errors import UsageError
from matcap.example.example import Example, known_part
from matcap.example.repeat import flatten, is_cut, joined, repeated
from matcap.example.straighten import least_cut
from matcap.field.plane import Rectangle

MAPS = (slice(0, 3), slice(3, 4), slice(4, 5), slice(5, 6))
MATERIALS = ("leather", "cloth", "granite", "rust", "tile")


@cache
def of(material):
    piece = true_exemplar(material, 320, 256, detail=512)
    return repeated(piece.stacked(), piece.texel_size)


def steps(plane, axis):
    """How far apart a map's lines are, the last one from the first."""
    return np.abs(np.roll(plane, -1, axis) - plane)


@pytest.mark.parametrize("material", MATERIALS)
def test_gradients_across_the_border_equal_those_inside(material):
    maps = of(material).maps
    for channels in MAPS:
        for axis in (1, 2):
            along = steps(maps[channels], axis).mean(axis=(0, 3 - axis))
            assert along[-1] <= 1.1 * along[:-1].mean() + 1e-7


@pytest.mark.parametrize("material", MATERIALS[:-1])  # whose joints cuts run along
def test_gradients_across_the_cuts_equal_those_elsewhere(material):
    found = of(material)
    for channels in MAPS:
        both = sum(steps(found.maps[channels], axis).mean(axis=0) for axis in (1, 2))
        assert both[found.cut].mean() <= 1.1 * both[~found.cut].mean() + 1e-7


def test_cuts_along_joints_are_no_steeper_than_joints():
    found, piece = of("tile"), true_exemplar("tile", 320, 256, detail=512).stacked()
    for channels in MAPS:
        made, there = (
            sum(np.abs(np.diff(maps[channels], axis=axis)).mean() for axis in (1, 2))
            for maps in (found.maps, piece)
        )
        assert made <= 1.05 * there


def test_most_of_the_exemplar_is_kept():
    rows, columns = of("leather").cut.shape
    assert 0.6 * 256 < rows < 256 and 0.6 * 320 < columns < 320


def test_slow_drift_is_removed_and_stains_stay():
    piece = true_exemplar("plaster", 256, 192, detail=512).stacked()
    x = np.linspace(-1.0, 1.0, 256, dtype=np.float32)
    drifting = piece.copy()
    drifting[:4] *= np.exp(0.3 * x)
    drifting[4] += 0.1 * x
    drifting[:3, 90:100, 120:130] *= 0.3
    level, plain = flatten(drifting), flatten(piece)
    for index in range(5):
        halves = [level[index][:, part].mean() for part in (slice(0, 128), slice(128, 256))]
        assert halves[0] == pytest.approx(halves[1], rel=0.03)
    stain = level[:3, 90:100, 120:130] / plain[:3, 90:100, 120:130]
    assert stain.mean() == pytest.approx(0.3, rel=0.1)


def test_a_stain_occurs_once():
    piece = true_exemplar("plaster", 256, 192, detail=512)
    maps = piece.stacked()
    maps[:3, 90:102, 120:132] *= 0.2
    found = repeated(maps, piece.texel_size).maps
    dark = found[:3].mean(axis=0) < 0.4 * np.median(found[:3])
    assert dark.sum() == pytest.approx(144, rel=0.2)


def test_a_lattice_is_cut_to_whole_periods():
    example = ordered()
    found = repeated(example.exemplar.stacked(), example.exemplar.texel_size, example.index.lattice)
    for side, period in zip(found.cut.shape[::-1], PERIODS, strict=True):
        turns = side / period
        assert abs(turns - round(turns)) <= 0.02 * turns
    # All of the power of the joints lies at whole numbers of turns.
    across = np.abs(np.fft.rfft((found.maps[3] - found.maps[3].mean()).mean(axis=0)))
    assert np.argmax(across) % round(found.cut.shape[1] / PERIODS[0]) == 0


def test_the_cheapest_cut_is_found_and_closes():
    differences = np.random.default_rng(3).uniform(1.0, 2.0, (40, 20)).astype(np.float32)
    way = 10 + np.rint(5.0 * np.sin(np.arange(40) * 2.0 * np.pi / 40.0)).astype(int)
    for row, column in enumerate(way):
        low, high = sorted((column, way[(row + 1) % 40]))
        differences[row, low - 1 : high + 1] = 0.0
    cut, cost = least_cut(differences, 0.01, closed=True)
    assert np.abs(cut - way).max() <= 1 and cost < 0.2
    free, less = least_cut(differences, 0.01, closed=False)
    assert less <= cost and len(free) == 40


def test_an_exemplar_that_tiles_is_unchanged():
    y, x = np.mgrid[0:40, 0:60]
    random = np.random.default_rng(5).uniform(0.2, 0.8, (6, 40, 60)).astype(np.float32)
    twice = np.tile(random, (1, 2, 2))
    # Half of it from the next copy: the same maps, so that nothing is to be closed.
    x = x + 60 * (x < 20)
    np.testing.assert_allclose(joined(twice, x, y), random, atol=1e-5)
    assert is_cut(x, y)[:, 19].all() and not is_cut(x, y)[:39, 20:59].any()


def test_heights_are_closed_whatever_the_whole_rises_by():
    planes = blobs(160, 128)
    maps = planes.stacked()
    maps[5] += np.linspace(0.0, 1.0, 160, dtype=np.float32)
    found = repeated(maps, planes.texel_size).maps[5]
    plain = repeated(planes.stacked(), planes.texel_size).maps[5]
    assert steps(found, 1).max() < 3.0 * steps(plain, 1).max()


def test_the_tiled_exemplar_is_read_as_a_field():
    example = Example.of(blobs())
    source = example.repeating_source()
    width, height = source.period
    once = source.planes(Rectangle(0, 0, 1024, 256), "gl")
    np.testing.assert_array_equal(once[:, :, :100], once[:, :, width : width + 100])
    np.testing.assert_array_equal(
        source.planes(Rectangle(0, 0, 64, 64), "dx")[7], -once[7, :64, :64]
    )
    maps = example.repeating()
    assert maps.periodic and maps.size == (width, height)
    np.testing.assert_allclose(maps.normal.numpy(), once[6:, :height, :width], atol=1e-5)


def test_a_too_small_exemplar_is_refused():
    small = exemplar(np.random.default_rng(0).standard_normal((4, 20, 40)))
    with pytest.raises(UsageError, match="40 x 20 texels is too small to repeat"):
        repeated(small.stacked(), small.texel_size)


def test_synth_and_export_write_the_tiled_exemplar(tmp_path, capsys):
    a_material("blobs", example=an_example()).save(tmp_path / "blobs.matcap")
    file, folder = str(tmp_path / "blobs.matcap"), str(tmp_path / "piece")
    assert main(["synth", file, "--tile", "piece", "-q", "-o", folder]) == 0
    maps, document = read_mapset(tmp_path / "piece")
    wanted = an_example().repeating()
    assert maps.periodic and document["periodic"] and document["provenance"]["tile"] == "piece"
    assert seam_ratio(maps) <= 1.1
    np.testing.assert_allclose(maps.diffuse, wanted.diffuse, rtol=1e-3, atol=1e-3)
    textures = str(tmp_path / "textures")
    assert main(["export", file, "--to", "raw", "--tile", "piece", "-q", "-o", textures]) == 0
    for more in (["--size", "64"], ["--region", "0,0,8,8"], ["--seed", "3"], ["--variety", "0"]):
        assert main(["synth", file, "--tile", "piece", *more, "-o", folder]) == 2
        assert "fixed size" in capsys.readouterr().err
    assert main(["export", file, "--to", "raw", "--tile", "piece", "--size", "64"]) == 2


def test_a_decoder_without_an_exemplar_refuses_to_tile_it(tmp_path, capsys):
    a_material("plain", seed=5).save(tmp_path / "plain.matcap")
    assert main(["synth", str(tmp_path / "plain.matcap"), "--tile", "piece"]) == 2
    assert "has no exemplar to repeat" in capsys.readouterr().err


def test_texels_without_confidence_are_hardly_shown():
    piece = blobs()
    confidence = piece.confidence.copy()
    confidence[:, :, 120:] = 0.0
    confidence[:, 40:70, 30:60] = 0.0
    example = Example.of(replace(piece, confidence=confidence))
    places = example.places(3, Rectangle(0, 0, 256, 256), None)
    drawn = confidence[0][places[..., 1], places[..., 0]] == 0.0
    assert drawn.mean() < 0.002
    assert known_part(example.exemplar, 16) == Rectangle(0, 0, 120, piece.size[1])
    assert example.repeating().size[0] <= 120
