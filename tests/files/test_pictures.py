"""Pictures for people: PNG rounding, the sRGB curve, formats by suffix."""

import cv2
import numpy as np
import pytest

from matcap.errors import ExitCode, MatcapError
from matcap.files.exr import read_exr
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
