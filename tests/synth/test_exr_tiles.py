"""Tiled EXR files: what others read is what was written, also after a cut."""

import io

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest

from matcap.errors import MatcapError
from matcap.synth.exr_tiles import Channel, Layout, Tile, TileFile, encode_tile, stored

CHANNELS = (Channel("A", True), Channel("Z", False))


def tiles_of(layout):
    for level in range(layout.levels):
        columns, rows = layout.tiles(level)
        yield from (Tile(c, r, level) for r in reversed(range(rows)) for c in range(columns))


def planes_of(layout, tile):
    """Smooth in one channel, noise in the other, both other numbers for every tile."""
    shape = layout.shape(tile)
    noise = np.random.default_rng(layout.index(tile)).standard_normal(shape)
    smooth = np.add.outer(np.arange(shape[0]), np.arange(shape[1])) / 100 + layout.index(tile)
    return [smooth.astype(np.float16), noise.astype(np.float32)]


def write(stream, layout, count=None):
    file = TileFile(stream, layout)
    for tile in list(tiles_of(layout))[:count]:
        if tile not in file:
            file.append(tile, encode_tile(layout, tile, planes_of(layout, tile)))
    return file


def whole(layout, level, channel):
    width, height = layout.size(level)
    picture = np.zeros((height, width), np.float32)
    for tile in tiles_of(layout):
        if tile.level == level:
            picture[layout.area(tile)] = planes_of(layout, tile)[channel]
    return picture


@pytest.mark.parametrize(
    ("width", "height", "mipmap"),
    [
        (200, 130, False),
        (64, 64, False),
        (1, 1, False),
        (1, 1, True),
        (70, 1, True),
        (65, 129, True),
    ],
)
def test_others_read_what_was_written(tmp_path, width, height, mipmap):
    layout = Layout(width, height, CHANNELS, mipmap, "periodic,clamp" if mipmap else "")
    path = tmp_path / "tiles.exr"
    with path.open("w+b") as stream:
        write(stream, layout).finish()
    source = oiio.ImageInput.open(str(path))
    for level in range(layout.levels):
        pixels = source.read_image(0, level, 0, 2, "float")
        assert source.spec(0, level).tile_width == 64
        for channel in (0, 1):
            assert np.array_equal(pixels[..., channel], whole(layout, level, channel))
    assert source.spec().getattribute("wrapmodes") == (layout.wrap or None)
    source.close()
    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    assert np.array_equal(channels["Z"].pixels, whole(layout, 0, 1))
    assert channels["A"].pixels.dtype == np.float16


def test_a_file_that_was_cut_anywhere_is_completed_to_the_same_bytes(tmp_path):
    layout = Layout(150, 100, CHANNELS)
    path = tmp_path / "tiles.exr"
    with path.open("w+b") as stream:
        write(stream, layout).finish()
    good = path.read_bytes()
    start = len(layout.header()) + 8 * layout.count
    generator = np.random.default_rng(0)
    for length in [0, 10, start - 3, start + 7, *generator.integers(start, len(good), 12)]:
        path.write_bytes(good[:length])
        with path.open("r+b") as stream:
            write(stream, layout).finish()
        same = path.read_bytes() == good
        assert same, length
    # A disk that lost power: the right length, but zeros where data should be.
    path.write_bytes(good[: start + 3000] + bytes(len(good) - start - 3000))
    with path.open("r+b") as stream:
        write(stream, layout).finish()
    same = path.read_bytes() == good
    assert same


def test_other_files_are_not_gone_on_with():
    layout = Layout(64, 64, CHANNELS)
    for before in (b"something else" * 1000, Layout(65, 64, CHANNELS).header() + bytes(9000)):
        assert TileFile(_stream(before), layout).written == 0


def test_a_file_with_holes_is_not_finished():
    with pytest.raises(ValueError, match="missing"):
        write(_stream(b""), Layout(150, 100, CHANNELS), count=5).finish()


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e6])
def test_what_half_floats_cannot_hold_is_refused(value):
    with pytest.raises(MatcapError, match=r"a\.exr"):
        stored(CHANNELS[0], np.full((2, 2), value, np.float32), "a.exr")


def _stream(content):
    stream = io.BytesIO()
    stream.write(content)
    return stream
