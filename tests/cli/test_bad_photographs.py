"""What is no photograph: one sentence with a remedy, exit code 3, nothing left behind."""

import cv2
import numpy as np
import pytest
import tifffile


def write_image(path, pixels):
    _, encoded = cv2.imencode(path.suffix, pixels)
    path.write_bytes(encoded.tobytes())


def half(path):
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])


def noise(side=128):
    return np.random.default_rng(0).integers(0, 255, (side, side, 3), dtype=np.uint8)


def missing(path):
    pass


def empty(path):
    path.touch()


def directory(path):
    path.mkdir()


def text(path):
    path.write_text("not a photograph at all\n" * 100)


def truncated(path):
    if path.suffix == ".dng":
        path.write_bytes(b"II*\0\x08\0\0\0")
    else:
        write_image(path, noise())
        half(path)


def zeros(path):
    path.write_bytes(bytes(100_000))


def black(path):
    write_image(path, np.zeros((128, 128, 3), dtype=np.uint8))


def white(path):
    write_image(path, np.full((128, 128, 3), 255, dtype=np.uint8))


def one_pixel(path):
    write_image(path, noise(1))


def not_finite(path):
    pixels = np.full((128, 128, 3), 0.5, dtype=np.float32)
    pixels[5, 6] = np.nan
    pixels[7, 8] = np.inf
    tifffile.imwrite(path, pixels, photometric="rgb")


CASES = [
    (missing, "a.dng"),
    (missing, "a.jpg"),
    (empty, "a.dng"),
    (empty, "a.jpg"),
    (directory, "a.dng"),
    (text, "a.dng"),
    (text, "a.jpg"),
    (text, "a.xyz"),
    (truncated, "a.dng"),
    (truncated, "a.jpg"),
    (truncated, "a.png"),
    (zeros, "a.dng"),
    (black, "a.jpg"),
    (white, "a.png"),
    (one_pixel, "a.png"),
    (one_pixel, "a.jpg"),
    (not_finite, "a.tif"),
]


@pytest.mark.parametrize(("make", "name"), CASES, ids=[f"{m.__name__}-{n}" for m, n in CASES])
def test_a_bad_photograph(matcap, never_captured, tmp_path, make, name):
    path = tmp_path / name
    make(path)
    before = list(tmp_path.iterdir())
    said = matcap("capture", path, "-o", tmp_path / "out", "-q")
    assert said.code == 3
    assert said.out == ""
    assert said.err.startswith(f"matcap: {path}: ")
    assert said.err.count("\n") == 1
    assert "; " in said.err  # the remedy
    assert said.err.endswith(".\n")
    assert list(tmp_path.iterdir()) == before
