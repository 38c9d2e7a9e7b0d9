"""Pictures for people, and masks as painting programs save them."""

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from matcap.errors import ExitCode, MatcapError
from matcap.files.exr import read_exr
from matcap.files.mask import read_mask
from matcap.files.picture import write_picture
from matcap.files.png import write_png


def read(path):
    """OpenCV's own order back to red, green, blue."""
    stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    return stored[..., ::-1] if stored.ndim == 3 else stored


@pytest.mark.parametrize("bits", [8, 16])
def test_codes_are_rounded_not_truncated(tmp_path, bits):
    most = 2**bits - 1
    codes = np.array([[0.0, 0.49, 0.51, 1.49, 1.51, most - 0.51, most - 0.49, most]])
    write_png(tmp_path / "a.png", (codes / most).astype(np.float32), bits=bits)
    assert read(tmp_path / "a.png").tolist() == [[0, 0, 1, 1, 2, most - 1, most, most]]


def test_colours_keep_their_order(tmp_path):
    red = np.zeros((2, 3, 3), dtype=np.float32)
    red[..., 0] = 1.0
    write_png(tmp_path / "a.png", red, bits=16)
    stored = read(tmp_path / "a.png")
    assert stored.dtype == np.uint16
    assert stored[0, 0].tolist() == [65535, 0, 0]


def test_picture_formats_by_suffix(tmp_path):
    image = np.full((4, 5, 3), 0.21404114, dtype=np.float32)
    image[0, 0] = 7.5
    write_picture(image, tmp_path / "new" / "a.exr")
    assert np.array_equal(read_exr(tmp_path / "new" / "a.exr").pixels, image)
    write_picture(image, tmp_path / "a.PNG")
    assert read(tmp_path / "a.PNG")[1, 1].tolist() == [128, 128, 128]
    assert read(tmp_path / "a.PNG")[0, 0].tolist() == [255, 255, 255]


def test_bad_pictures_leave_nothing(tmp_path):
    with pytest.raises(MatcapError, match="unknown picture format") as caught:
        write_picture(np.zeros((2, 2, 3), dtype=np.float32), tmp_path / "a.jpg")
    assert caught.value.exit_code == ExitCode.USAGE
    for name in ("a.png", "a.exr"):
        with pytest.raises(MatcapError, match="not finite"):
            write_picture(np.full((2, 2, 3), np.nan, dtype=np.float32), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


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
