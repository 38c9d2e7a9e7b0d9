"""Texels of a map set, and the files that OpenImageIO makes of them."""

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest

from matcap.errors import MatcapError
from matcap.field.plane import Grid, Rectangle, block_parts
from matcap.synth.pictures import Assembly, texel_type, texels_of, write_map

SIZES = [(200, 130), (64, 64), (1, 1), (70, 1), (65, 129)]


def planes_of(size, specular=1):
    """Noise in every plane, of another number in each."""
    noise = np.random.default_rng(size[0]).random((8 + specular, size[1], size[0]), np.float32)
    return noise + np.arange(8 + specular, dtype=np.float32)[:, None, None]


def parts_of(size):
    return list(enumerate(block_parts(Rectangle(-5, -3, *size), Grid(64, 32), None)))


def assembled(folder, size, texels, parts):
    """An assembly that parts are added to in the order given."""
    made = Assembly(folder / ".0.texels", size, texels.dtype)
    for index, part in parts:
        made.add(index, part, texels[part.target])
    return made


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("wrap", ["", "periodic,clamp"])
def test_other_programs_read_the_computed_texels(tmp_path, size, wrap):
    texels = texels_of(planes_of(size, specular=3), 3)
    made = assembled(tmp_path, size, texels, reversed(parts_of(size)))
    for kind in texel_type(3).names:
        path = tmp_path / f"{kind}.exr"
        write_map(path, kind, made, wrap)
        source = oiio.ImageInput.open(str(path))
        spec = source.spec()
        assert (spec.tile_width, spec.tile_height) == (64, 64)
        assert spec.getattribute("wrapmodes") == (wrap or None)
        assert spec.getattribute("DateTime") is None  # or a resumed run would differ
        assert np.array_equal(source.read_image("float"), texels[kind].astype(np.float32))
        assert oiio.ImageBuf(str(path)).nmiplevels == (max(size).bit_length() if wrap else 1)
        source.close()
    made.close()
    channels = OpenEXR.File(str(tmp_path / "normal.exr"), separate_channels=True).channels()
    assert np.array_equal(channels["G"].pixels, texels["normal"][..., 1])
    assert channels["G"].pixels.dtype == np.float16


@pytest.mark.parametrize("size", [(64, 32), (65, 129)])
def test_smaller_levels_are_rougher_by_the_slopes_that_they_average(tmp_path, size):
    """As relight's own levels are: alpha^2 + E[s^2] - E[s]^2, whatever level they come from."""
    slopes = 0.3 * np.random.default_rng(4).standard_normal((2, *size[::-1])).astype(np.float32)
    upright = 1.0 / np.sqrt(1.0 + np.square(slopes).sum(axis=0))
    planes = np.full((9, *size[::-1]), 0.3, np.float32)
    planes[6:8], planes[8] = -slopes * upright, upright
    texels = texels_of(planes, 1)
    made = assembled(tmp_path, size, texels, parts_of(size))
    write_map(tmp_path / "roughness.exr", "roughness", made, "periodic,periodic")
    made.close()
    source = oiio.ImageInput.open(str(tmp_path / "roughness.exr"))
    levels = [source.read_image(0, level, 0, 1, "float")[..., 0] for level in range(6)]
    source.close()
    assert np.array_equal(levels[0], texels["roughness"][..., 0].astype(np.float32))
    if size == (64, 32):
        mean, squares = (
            each.reshape(-1, 16, 2, 32, 2).mean(axis=(2, 4)) for each in (slopes, slopes**2)
        )
        expected = (0.3**4 + (squares - mean**2).sum(axis=0)) ** 0.25
        assert levels[1] == pytest.approx(expected, rel=2e-3)
    whole = (0.3**4 + slopes.var(axis=(1, 2)).sum()) ** 0.25
    assert levels[5].mean() == pytest.approx(whole, rel=0.05)


def test_an_interrupted_assembly_has_its_whole_parts_and_not_the_damaged_ones(tmp_path):
    size = (150, 100)
    texels, parts = texels_of(planes_of(size), 1), parts_of(size)
    assembled(tmp_path, size, texels, parts[:6]).close()
    path = tmp_path / ".0.texels"
    known = path.with_suffix(".parts").read_bytes()
    path.with_suffix(".parts").write_bytes(known[:-3])  # the last was not listed whole
    data = bytearray(path.read_bytes())
    rows, columns = parts[2][1].target
    data[(rows.start * size[0] + columns.start) * texels.dtype.itemsize] ^= 1
    path.write_bytes(data)
    again = Assembly(path, size, texels.dtype)
    assert [again.has(index, part) for index, part in parts[:7]] == [
        True, True, False, True, True, False, False,
    ]  # fmt: skip
    for index, part in parts:
        if not again.has(index, part):
            again.add(index, part, texels[part.target])
    assert np.array_equal(again.rows(slice(0, size[1])), texels)
    again.finish()
    finished = Assembly(path, size, texels.dtype)
    assert finished.written and all(finished.has(index, part) for index, part in parts)
    finished.close()


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e6])
def test_values_that_half_floats_cannot_hold_are_refused(value):
    planes = planes_of((4, 4))
    planes[1, 2, 3] = value
    with pytest.raises(MatcapError, match="diffuse"):
        texels_of(planes, 1)
