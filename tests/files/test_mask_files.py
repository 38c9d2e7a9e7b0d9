"""What is meant by a mask, as painting programs save it."""

import numpy as np
import pytest
import tifffile
from PIL import Image

from matcap.errors import MatcapError
from matcap.files.mask import read_mask

SHAPE = np.clip(np.linspace(-0.5, 1.5, 16 * 12).reshape(12, 16), 0.0, 1.0)
CODES = np.rint(255 * SHAPE).astype(np.uint8)


def saved(path, *planes):
    Image.fromarray(np.stack(planes, axis=-1) if len(planes) > 1 else planes[0]).save(path)
    return read_mask(path)


FULL, EMPTY = np.full_like(CODES, 255), np.zeros_like(CODES)


@pytest.mark.parametrize(
    "planes",
    [
        (CODES,),
        (CODES, CODES, CODES),
        (CODES, FULL),  # grey and an opaque alpha
        (CODES, CODES, CODES, FULL),
        (FULL, CODES),  # white, with the shape in alpha
        (FULL, FULL, FULL, CODES),
        (EMPTY, EMPTY, EMPTY, CODES),  # painted in black on nothing
        (FULL, EMPTY, EMPTY, CODES),  # in red
        (CODES // 2, CODES, 255 - CODES, CODES),  # a cut-out of what has colours
    ],
)
def test_grey_and_alpha_mean_the_same(tmp_path, planes):
    np.testing.assert_allclose(saved(tmp_path / "a.png", *planes), CODES / 255.0, atol=2e-3)


def test_a_painted_layer_is_seen_over_black(tmp_path):
    alpha = np.where(np.arange(16) < 8, 255, 0).astype(np.uint8) + EMPTY
    found = saved(tmp_path / "a.png", CODES, CODES, CODES, alpha)
    np.testing.assert_allclose(found, CODES / 255.0 * (alpha > 0), atol=1e-6)


def test_sixteen_bits_palettes_and_other_kinds(tmp_path):
    Image.fromarray(np.rint(65535 * SHAPE).astype(np.uint16)).save(tmp_path / "a.png")
    np.testing.assert_allclose(read_mask(tmp_path / "a.png"), SHAPE, atol=1e-5)
    black = Image.fromarray(CODES > 127)
    for name in ("b.png", "b.tif", "b.bmp"):
        black.save(tmp_path / name)
        np.testing.assert_array_equal(read_mask(tmp_path / name), CODES > 127)
    black.convert("P").save(tmp_path / "p.png", transparency=0)
    np.testing.assert_array_equal(read_mask(tmp_path / "p.png"), CODES > 127)
    tifffile.imwrite(tmp_path / "f.tif", SHAPE.astype(np.float32), photometric="minisblack")
    np.testing.assert_allclose(read_mask(tmp_path / "f.tif"), SHAPE, atol=1e-6)


def test_what_is_no_mask(tmp_path):
    with pytest.raises(MatcapError, match="transparent"):
        saved(tmp_path / "a.png", FULL, FULL, FULL, EMPTY)
    tifffile.imwrite(tmp_path / "f.tif", 3.0 * SHAPE.astype(np.float32), photometric="minisblack")
    with pytest.raises(MatcapError, match="not from 0 to 1"):
        read_mask(tmp_path / "f.tif")
    (tmp_path / "t.png").write_text("no picture")
    with pytest.raises(MatcapError, match="not a readable picture"):
        read_mask(tmp_path / "t.png")
    with pytest.raises(MatcapError, match="missing"):
        read_mask(tmp_path / "none.png")
