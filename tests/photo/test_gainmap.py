"""A DNG's lens shading: parsed, evaluated as the standard says, applied where it belongs."""

import struct

import numpy as np
import pytest
from simulated.files import BLACK, WHITE, color_matrix, gain_map, mosaic, opcode_list, write_dng

from matcap.errors import MatcapError
from matcap.photo.gainmap import Shading, parse_opcodes
from matcap.photo.load import load_photo

SIZE = (96, 128)
PLACES = [(0, 0), (0, 1), (1, 0), (1, 1)]


@pytest.fixture
def grid() -> np.ndarray:
    """(5, 7, 1) gains that grow to the corners, and differ everywhere."""
    y, x = np.mgrid[-1:1:5j, -1:1:7j]
    return (1.0 + 0.8 * x**2 + 0.5 * y**2 + 0.1 * x)[..., None]


def reference_gain(grid: np.ndarray, row: int, column: int) -> float:
    """Chapter 7's words, one pixel at a time, for a map spread over the whole picture."""
    v = (row + 0.5) / SIZE[0] * (grid.shape[0] - 1)
    h = (column + 0.5) / SIZE[1] * (grid.shape[1] - 1)
    i, j = min(int(v), grid.shape[0] - 2), min(int(h), grid.shape[1] - 2)
    top = grid[i, j] * (1 - h + j) + grid[i, j + 1] * (h - j)
    bottom = grid[i + 1, j] * (1 - h + j) + grid[i + 1, j + 1] * (h - j)
    return float(top * (1 - v + i) + bottom * (v - i))


def test_gains_follow_the_standard(grid):
    maps, vignette = parse_opcodes(opcode_list(gain_map(grid, SIZE)))
    gains = Shading(maps, SIZE, SIZE).gains(10, 30, 1)
    assert not vignette
    for row, column in [(10, 0), (10, 127), (29, 64), (15, 33)]:
        expected = reference_gain(grid[..., 0], row, column)
        assert gains[row - 10, column, 0] == pytest.approx(expected, rel=1e-6)


def test_strips_join_up(grid):
    maps = parse_opcodes(opcode_list(gain_map(grid, SIZE, offset=(1, 0), pitch=2)))[0]
    shading = Shading(maps, SIZE, SIZE)
    strips = [shading.gains(top, min(top + 7, 96), 1) for top in range(0, 96, 7)]
    np.testing.assert_array_equal(np.concatenate(strips), shading.gains(0, 96, 1))


def test_maps_touch_only_their_photosites():
    """Phones write a map for each place in the two by two."""
    flats = [np.full((1, 1, 1), gain) for gain in (1.5, 2.0, 3.0, 4.0)]
    opcodes = [
        gain_map(flat, SIZE, offset=place, pitch=2)
        for flat, place in zip(flats, PLACES, strict=True)
    ]
    gains = Shading(parse_opcodes(opcode_list(*opcodes))[0], SIZE, SIZE).gains(0, 96, 1)[..., 0]
    np.testing.assert_array_equal(gains[:2, :2], [[1.5, 2.0], [3.0, 4.0]])
    np.testing.assert_array_equal(gains, np.tile(gains[:2, :2], (48, 64)))


@pytest.mark.parametrize("long_side", [None, 64])
def test_flat_field_comes_out_flat(tmp_path, grid, long_side):
    """A grey wall behind a lens with falloff; also where the gains lift it past the white level."""
    maps = parse_opcodes(opcode_list(gain_map(grid, SIZE)))[0]
    falloff = 1.0 / Shading(maps, SIZE, SIZE).gains(0, 96, 1)
    neutral = (0.5, 1.0, 0.6)
    samples = mosaic(0.9 * falloff * neutral)
    path = write_dng(
        tmp_path / "a.dng", samples, neutral=neutral, opcodes2=opcode_list(gain_map(grid, SIZE))
    )
    photo = load_photo(path, long_side=long_side)
    assert photo.gain_map_applied
    np.testing.assert_allclose(photo.pixels, 0.9, rtol=6e-3)
    assert photo.pixels.mean() == pytest.approx(0.9, rel=1e-3)
    plain = load_photo(write_dng(tmp_path / "b.dng", samples, neutral=neutral))
    assert not plain.gain_map_applied
    assert plain.pixels.min() < 0.5


def test_gains_do_not_clip_what_was_not_clipped(tmp_path):
    """0.8 of the white level times 2 is 1.6, a number, not a clipped pixel."""
    flat = opcode_list(gain_map(np.full((2, 2, 1), 2.0), SIZE))
    path = write_dng(tmp_path / "a.dng", mosaic(np.full((*SIZE, 3), 0.8)), opcodes2=flat)
    photo = load_photo(path)
    np.testing.assert_allclose(photo.pixels, 1.6, rtol=1e-3)
    assert not photo.clipped.any()


def test_map_by_photosite_reaches_its_colour(tmp_path):
    """Red photosites were shaded to a half, the others not."""
    opcodes = opcode_list(gain_map(np.full((1, 1, 1), 2.0), SIZE, pitch=2))
    light = np.full((*SIZE, 3), 0.4) * (0.5, 1.0, 1.0)
    photo = load_photo(write_dng(tmp_path / "a.dng", mosaic(light), opcodes2=opcodes))
    np.testing.assert_allclose(photo.pixels, 0.4, rtol=3e-3)


@pytest.mark.parametrize("option", ["opcodes2", "opcodes3"])
def test_linear_dng_by_plane(tmp_path, grid, option):
    tinted = np.concatenate([grid, 1.2 * grid, 1.5 * grid**2], axis=2)
    maps = parse_opcodes(opcode_list(gain_map(tinted, SIZE, planes=3)))[0]
    # The gains differ by plane, and are for the colours of a camera that mixes them.
    mixing = np.array([[0.8, 0.2, 0.0], [0.1, 0.8, 0.1], [0.0, 0.3, 0.7]])
    rec709 = np.array([0.4, 0.3, 0.2])
    light = rec709 @ mixing.T / Shading(maps, SIZE, SIZE).gains(0, 96, 3)
    samples = np.rint(BLACK + light * (WHITE - BLACK)).astype(np.uint16)
    options = {option: opcode_list(gain_map(tinted, SIZE, planes=3))}
    options["color_matrix"] = color_matrix(mixing)
    path = write_dng(tmp_path / "a.dng", samples, **options)
    picture = load_photo(path)
    assert picture.gain_map_applied
    inside = picture.pixels[~picture.clipped]
    assert len(inside) > 0.9 * picture.clipped.size
    np.testing.assert_allclose(inside, np.tile(rec709, (len(inside), 1)), rtol=2e-2)


@pytest.mark.parametrize("long_side", [None, 64])
def test_after_demosaicing(tmp_path, long_side):
    y, x = np.mgrid[-1:1:3j, -1:1:3j]
    grid = (1.0 + 0.3 * x + 0.2 * y)[..., None]
    opcodes = opcode_list(gain_map(grid, SIZE, planes=3))
    light = 0.4 / Shading(parse_opcodes(opcodes)[0], SIZE, SIZE).gains(0, 96, 3)
    photo = load_photo(
        write_dng(tmp_path / "a.dng", mosaic(light), opcodes3=opcodes), long_side=long_side
    )
    assert photo.gain_map_applied
    np.testing.assert_allclose(photo.pixels[1:-1, 1:-1], 0.4, rtol=1e-2)


def test_after_demosaicing_by_colour_and_past_white(tmp_path):
    gains = np.array([2.0, 1.5, 1.6])
    opcodes = opcode_list(gain_map(np.tile(gains, (2, 2, 1)), SIZE, planes=3))
    path = write_dng(
        tmp_path / "a.dng", mosaic(np.ones((*SIZE, 3)) * 1.2 / gains), opcodes3=opcodes
    )
    for long_side in (None, 64):
        photo = load_photo(path, long_side=long_side)
        np.testing.assert_allclose(photo.pixels, 1.2, rtol=2e-3)
        assert not photo.clipped.any()


def test_places_count_from_the_active_area(tmp_path, grid):
    """Behind an odd margin of masked pixels, which LibRaw makes even."""
    maps = [gain_map(grid * (1.5 if p == (0, 0) else 1.0), SIZE, offset=p, pitch=2) for p in PLACES]
    opcodes = opcode_list(*maps)
    gains = Shading(parse_opcodes(opcodes)[0], SIZE, SIZE).gains(0, 96, 1)[..., 0]
    active = BLACK + (mosaic(np.full((*SIZE, 3), 0.5)) - float(BLACK)) / gains
    stored = np.zeros((96 + 3, 128 + 5), np.uint16)
    stored[3:, 5:] = np.rint(active)
    path = write_dng(tmp_path / "a.dng", stored, opcodes2=opcodes, active_area=(3, 5, 99, 133))
    picture = load_photo(path)
    assert min(picture.pixels.shape[:2]) >= SIZE[0] - 1
    np.testing.assert_allclose(picture.pixels, 0.5, rtol=4e-3)


@pytest.mark.parametrize(("opcode", "named"), [(1, "distortion"), (12, "rows"), (5, None)])
def test_what_changes_light_or_place_is_named(tmp_path, light, opcode, named):
    asked = opcode_list(struct.pack(">4I", opcode, 0x01030000, 0, 4) + bytes(4))
    photo = load_photo(write_dng(tmp_path / "a.dng", mosaic(light), opcodes3=asked))
    assert [named in note for note in photo.notes] == ([True] if named else [])


def test_radial_vignette_is_named(tmp_path, light):
    vignette = struct.pack(">4I", 3, 0x01030000, 0, 56) + struct.pack(">7d", *([0.1] * 5), 0.5, 0.5)
    photo = load_photo(write_dng(tmp_path / "a.dng", mosaic(light), opcodes3=opcode_list(vignette)))
    assert not photo.gain_map_applied
    assert any("vignette" in note for note in photo.notes)


@pytest.mark.parametrize(
    "broken",
    [
        opcode_list(gain_map(np.ones((5, 5, 1)), SIZE))[:-8],
        opcode_list(gain_map(np.full((2, 2, 1), np.nan), SIZE)),
        opcode_list(gain_map(np.ones((2, 2, 1)), SIZE, pitch=0)),
        struct.pack(">I", 9),
    ],
    ids=["short", "nan", "pitch", "count"],
)
def test_broken_maps_are_refused(tmp_path, light, broken):
    path = write_dng(tmp_path / "a.dng", mosaic(light), opcodes2=broken)
    with pytest.raises(MatcapError, match="damaged"):
        load_photo(path)
