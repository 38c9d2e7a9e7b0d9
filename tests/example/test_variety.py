"""How far a field takes its piece apart: from the piece repeated to many small ones."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from exemplars import an_example, blobs, exemplar, ordered
from materials import a_material

from matcap.brdf.folder import read_mapset
from matcap.cli.main import main
from matcap.errors import UsageError
from matcap.example.example import Example
from matcap.example.patch_sizes import PatchSizes
from matcap.example.summary import summary
from matcap.example.variety import is_plaid, variety_trials, with_chosen_variety
from matcap.field.material import Material
from matcap.field.plane import Rectangle
from matcap.flash.geometry import FlashSetup


def joined(example, side=384):
    """The share of texels that continue their left neighbour in the exemplar."""
    places = example.places(9, Rectangle(0, 0, side, side), None).astype(int)
    return float((np.diff(places, axis=1) == [1, 0]).all(-1).mean())


@pytest.mark.parametrize("example", [an_example(), ordered()], ids=["blobs", "bricks"])
def test_less_variety_is_larger_pieces(example):
    shares = [joined(example.varied(variety)) for variety in (0.0, 0.3, 1.0)]
    assert shares[0] > shares[1] > shares[2]
    assert shares[0] > 0.97


def test_pieces_shrink_from_the_whole_frame_to_those_of_full_variety():
    lookup = an_example().lookup
    level = lookup.levels[-1]
    sizes = [PatchSizes.of(level.frame, level.spacing, None, one / 8) for one in range(9)]
    for larger, smaller in zip(sizes, sizes[1:], strict=False):
        assert larger.width >= smaller.width and larger.height >= smaller.height
    assert sizes[0].width > 0.5 * (level.frame.right - level.frame.left)
    assert sizes[-1].loose and not sizes[-2].loose
    assert lookup.sizes == sizes[-1]


def test_large_patches_show_all_of_the_exemplar_equally_often():
    example = Example.of(blobs(512, 384)).varied(0.3)
    frame = example.lookup.joined
    x, y = example.places(2, Rectangle(0, 0, 2048, 2048), None)[::4, ::4].reshape(-1, 2).T
    sides = (np.linspace(frame.left, frame.right, 5), np.linspace(frame.top, frame.bottom, 5))
    shown = np.histogram2d(x, y, bins=sides)[0]
    assert shown.min() > 0.5 * shown.mean() and shown.max() < 1.5 * shown.mean()


@pytest.mark.parametrize(
    "example", [Example.of(blobs(512, 384)), ordered(512, 384)], ids=["blobs", "bricks"]
)
def test_the_least_variety_repeats_the_exemplar(example):
    example = example.varied(0.0)
    frame = example.lookup.joined
    wide, high = frame.right - frame.left + 1, frame.bottom - frame.top + 1
    one, other = (example.places(2, Rectangle(x, 300, 256, 256), None) for x in (50, 50 + wide))
    above = example.places(2, Rectangle(50, 300 - high, 256, 256), None)
    # Blocks begin elsewhere in the second copy, so that corrections may differ.
    assert (one == other).all(-1).mean() > 0.95 and (one == above).all(-1).mean() > 0.95


@pytest.mark.parametrize("variety", [0.0, 0.5])
@pytest.mark.parametrize("period", [(80, 48), (416, 304), (None, 304)])
def test_larger_pieces_repeat_exactly_too(variety, period):
    maps = an_example().varied(variety).maps(3, Rectangle(-33, 7, 500, 350), period)
    columns, rows = period
    if columns:
        assert np.array_equal(maps[:, :, :-columns], maps[:, :, columns:])
    assert np.array_equal(maps[:, :-rows], maps[:, rows:])


def test_a_variety_is_stored_and_full_variety_is_as_before_there_was_one():
    tensors, about = an_example().varied(0.25).stored()
    again = Example.read(about, tensors.__getitem__)
    assert again.variety == 0.25
    area = Rectangle(0, 0, 64, 64)
    assert np.array_equal(again.maps(1, area, None), an_example().varied(0.25).maps(1, area, None))
    assert "variety" not in an_example().stored()[1]
    del about["variety"]
    assert Example.read(about, tensors.__getitem__).variety == 1.0
    with pytest.raises(ValueError, match="variety"):
        Example.read(about | {"variety": 1.5}, tensors.__getitem__)


def test_a_material_is_read_with_another_variety():
    example = an_example()
    material = Material("blobs", {"example": example}, example.exemplar.texel_size, FlashSetup())
    one = material.varied(0.0).maps(96, 64, seed=2)
    assert not torch.equal(one.stacked(), material.maps(96, 64, seed=2).stacked())
    assert torch.equal(one.stacked(), material.varied(0.0).maps(96, 64, seed=2).stacked())
    assert material.varied(None) is material
    with pytest.raises(UsageError, match="variety of 2"):
        material.varied(2.0)


def test_every_command_that_reads_a_material_takes_a_variety(tmp_path, capsys):
    a_material("blobs", example=an_example()).save(tmp_path / "blobs.matcap")
    file, small = str(tmp_path / "blobs.matcap"), ["--size", "64x48", "-q"]
    for name, variety in (("own", []), ("one", ["--variety", "1"]), ("less", ["--variety", "0"])):
        words = ["synth", file, *small, *variety, "-o", str(tmp_path / name)]
        assert main(words) == 0
    own, one, less = (read_mapset(tmp_path / name) for name in ("own", "one", "less"))
    assert torch.equal(own[0].stacked(), one[0].stacked())
    assert not torch.equal(own[0].stacked(), less[0].stacked())
    assert less[1]["provenance"]["variety"] == 0.0 and "variety" not in own[1]["provenance"]
    asked = ["--variety", "0"]
    textures, picture, page = (str(tmp_path / name) for name in ("textures", "a.png", "a.html"))
    assert main(["export", file, *small, "--to", "gltf-textures", *asked, "-o", textures]) == 0
    assert main(["relight", file, *small, *asked, "-o", picture]) == 0
    assert main(["view", file, "-q", "--tile", "64", *asked, "--html", page]) == 0
    capsys.readouterr()
    assert main(["relight", str(tmp_path / "own"), *asked, "-o", picture]) == 2
    assert "where this is fixed" in capsys.readouterr().err
    assert main(["synth", file, "--variety", "1.5"]) == 2
    plain = a_material("plain", seed=5)
    plain.save(tmp_path / "plain.matcap")
    assert main(["synth", str(tmp_path / "plain.matcap"), *asked]) == 2
    assert "no patches" in capsys.readouterr().err


@pytest.mark.parametrize(
    "example",
    [ordered().varied(0.3), ordered(480, 320, (24.0, 24.0), 0.5).varied(0.1)],
    ids=["nearly-straight", "bent"],
)
def test_a_lattice_keeps_its_phase_in_larger_pieces(example):
    lattice = example.index.lattice
    for x, y in ((0, 0), (16384, -16384), (2**40 - 128, 2**39)):
        places = example.places(3, Rectangle(x, y, 192, 192), None).astype(np.int64)
        columns, rows = np.arange(x, x + 192)[None, :], np.arange(y, y + 192)[:, None]
        apart = lattice.phases(places[..., 0], places[..., 1]) - lattice.ideal_phases(
            3, columns, rows, (None, None)
        )
        turns = apart.astype(float) / 2**16
        assert abs(turns.mean()) < 0.03 and np.sqrt((turns**2).mean()) < 0.06


@pytest.mark.parametrize(
    "bend, spread, bent", [(0.5, 0.0, True), (0.0, 0.0, False), (0.5, 0.3, False)]
)
def test_offsets_that_jump_are_errors_and_no_bend(bend, spread, bent):
    lattice = ordered(480, 320, (24.0, 24.0), bend).index.lattice
    jumps = np.random.default_rng(0).standard_normal(lattice.phase_offsets.shape) * spread
    moved = lattice.phase_offsets + np.rint(2**16 * (jumps + np.rint(9 * jumps))).astype(np.int32)
    assert replace(lattice, phase_offsets=moved).is_bent == bent


def stripes(width=512, height=384):
    """Boards as long as the photograph, each of its own colour, some 25 texels wide."""
    random = np.random.default_rng(4)
    edges = np.cumsum(random.integers(14, 40, 40))
    board = np.searchsorted(edges, np.arange(height))[:, None] + np.zeros((1, width), int)
    colour = random.standard_normal(60)[board]
    grain = 0.1 * random.standard_normal((4, height, width))
    return exemplar(np.stack([colour, colour, 0.3 * colour, np.zeros_like(colour)]) + grain)


def plaid():
    """Bands of stripes() across and down, of cloth whose threads are a lattice of five texels."""
    bands = stripes().diffuse * stripes(384, 512).diffuse.swapaxes(1, 2)
    y, x = np.mgrid[0:384, 0:512] * 2.0 * np.pi / 5.0
    threads = 1.0 + 0.3 * np.cos(x) * np.cos(y)
    return replace(stripes(), diffuse=(bands * threads).clip(0.0, 1.0).astype(np.float32))


@pytest.mark.parametrize("waves", [(), ((0.2, 0.0), (0.0, 0.2))], ids=["plain", "lattice"])
def test_a_plaid_repeats_whole_and_boards_do_not(waves):
    assert with_chosen_variety(Example.of(plaid(), waves)).variety == 0.0
    assert not is_plaid(Example.of(stripes()))


def test_a_cloth_of_uneven_threads_is_no_plaid():
    draws = np.random.default_rng(3)
    across, down = (1.0 + 0.3 * draws.standard_normal(n).repeat(8) for n in (64, 48))
    threads = np.sqrt(down[:, None] * across).clip(0.1, 2.0)
    diffuse = (0.4 * np.broadcast_to(threads, (3, 384, 512))).clip(0.0, 1.0)
    assert not is_plaid(Example.of(replace(stripes(), diffuse=diffuse.astype(np.float32))))


def test_a_lattice_of_large_cells_is_no_plaid():
    assert not is_plaid(Example.of(plaid(), ((1 / 40, 0.0), (0.0, 1 / 40))))


def test_what_has_no_long_structure_is_taken_apart_and_boards_are_not():
    assert with_chosen_variety(Example.of(blobs(512, 384))).variety == 1.0
    boards = Example.of(stripes())
    long, tries = variety_trials(boards)
    first, *_, last = tries
    assert long > 0.1 and last.lost < 0.8 * first.lost
    assert with_chosen_variety(boards).variety < 1.0


def test_the_summary_says_how_large_pieces_are():
    whole, small = summary(an_example().varied(0.0)), summary(an_example())
    assert whole.patches[0] > small.patches[0]
    assert "% of the photograph" in whole.patches_text()
    # Texels of 2 / 1024 units of a metre.
    length = whole.patches[0] * 2 / 1024 * 100
    assert whole.patches_text(1000.0) == f"patches of about {length:.2g} cm"
    assert ("variety", f"0: {whole.patches_text()}.") in whole.lines()
