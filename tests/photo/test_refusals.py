"""Every file that cannot be used is refused in one sentence: where, what, remedy."""

import io
import os
from pathlib import Path

import numpy as np
import pytest
import tifffile
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from simulated.files import mosaic, write_dng

from matcap.errors import ExitCode, MatcapError
from matcap.photo.load import load_photo
from matcap.photo.photo import Photo
from matcap.photo.refusals import check_size


def refuse(path: Path) -> MatcapError:
    with pytest.raises(MatcapError) as caught:
        load_photo(path)
    error = caught.value
    assert str(error).startswith(str(path)) and "\n" not in str(error)
    assert error.remedy and error.exit_code is ExitCode.NOTHING_SUCCEEDED
    return error


def test_missing(tmp_path):
    error = refuse(tmp_path / "none.dng")
    assert "no such file" in error.what and isinstance(error.__cause__, FileNotFoundError)


def test_directory(tmp_path):
    assert "directory" in refuse(tmp_path).what


def test_empty(tmp_path):
    (tmp_path / "a.dng").touch()
    assert "empty" in refuse(tmp_path / "a.dng").what


def test_not_a_regular_file(tmp_path):
    os.mkfifo(tmp_path / "pipe.jpg")  # opening it would wait for ever
    assert "not a file" in refuse(tmp_path / "pipe.jpg").what


def test_no_permission(tmp_path, codes, monkeypatch):
    path = tmp_path / "a.png"
    Image.fromarray(codes).save(path)

    def denied(*_args, **_options):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "open", denied)  # chmod would not stop a superuser
    error = refuse(path)
    assert "may not be read" in error.what and isinstance(error.__cause__, PermissionError)


@pytest.mark.parametrize("name", ["notes.dng", "notes.jpg", "notes.nef", "notes.xyz"])
def test_text_under_a_false_name(tmp_path, name):
    (tmp_path / name).write_text("Dear diary, today I photographed a wall.\n" * 30)
    assert "text file" in refuse(tmp_path / name).what


@pytest.mark.parametrize(
    "head", [b"%PDF-1.7\n\x80\x81", b"PK\x03\x04\0\0", b"\0\0\0\x20ftypisom", b"\0"]
)
def test_wrong_type(tmp_path, head):
    (tmp_path / "a.jpg").write_bytes(head + bytes(2000))
    assert "not a photograph" in refuse(tmp_path / "a.jpg").what


@pytest.mark.parametrize("data", [b"II*\0\x08\0\0\0", bytes(100_000)])
def test_a_header_alone_and_zeros_are_no_raw(tmp_path, data):
    (tmp_path / "a.dng").write_bytes(data)
    refuse(tmp_path / "a.dng")


@pytest.mark.parametrize("suffix", ["png", "tif", "jpg"])
@pytest.mark.parametrize("shape", [(1, 1), (63, 500), (500, 63)])
def test_too_small(tmp_path, suffix, shape):
    path = tmp_path / f"a.{suffix}"
    Image.fromarray(np.full((*shape, 3), 128, np.uint8)).save(path)
    assert "too small" in refuse(path).what


def test_too_small_raw(tmp_path):
    path = write_dng(tmp_path / "a.dng", mosaic(np.full((40, 90, 3), 0.3)))
    assert "too small" in refuse(path).what


def test_a_header_that_claims_too_much(tmp_path, codes):
    """Refused before memory is asked for: 13 gigapixels in a file of a few kilobytes."""
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, codes, photometric="rgb", compression="zlib")
    with tifffile.TiffFile(path, mode="r+") as file:
        for tag in ("ImageWidth", "ImageLength", "RowsPerStrip"):
            file.pages.first.tags[tag].overwrite(60_000 if tag != "ImageWidth" else 65_000)
    refuse(path)
    with pytest.raises(MatcapError, match="more than can be read"):
        check_size(path, 60_000, 60_000)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_no_numbers(tmp_path, light, value):
    light[50, 60, 1] = value
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, light.astype(np.float32), photometric="rgb")
    assert "NaN or infinite" in refuse(path).what


@pytest.mark.parametrize("suffix", ["png", "tif", "jpg"])
@pytest.mark.parametrize(("value", "word"), [(0, "all black"), (255, "all white")])
def test_nothing_to_see(tmp_path, suffix, value, word):
    path = tmp_path / f"a.{suffix}"
    Image.fromarray(np.full((96, 128, 3), value, np.uint8)).save(path)
    assert word in refuse(path).what


@pytest.mark.parametrize(("value", "word"), [(0.0, "all black"), (2.0, "all white")])
def test_nothing_to_see_in_raw(tmp_path, value, word):
    path = write_dng(tmp_path / "a.dng", mosaic(np.full((96, 128, 3), value)))
    assert word in refuse(path).what


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[str, bytes]:
    """A small noisy picture in every form that is read without extras."""
    folder = tmp_path_factory.mktemp("whole")
    rng = np.random.default_rng(0)
    picture = rng.integers(20, 200, (64, 80, 3)).astype(np.uint8)
    files = {}
    for name, form in [("jpg", "JPEG"), ("png", "PNG"), ("tif", "TIFF")]:
        stream = io.BytesIO()
        Image.fromarray(picture).save(stream, form)
        files[name] = stream.getvalue()
    files["dng"] = write_dng(folder / "a.dng", mosaic(picture / 255.0)).read_bytes()
    return files


@pytest.mark.parametrize("form", ["jpg", "png", "tif", "dng"])
def test_half_a_file(tmp_path, whole, form, capfd):
    path = tmp_path / f"half.{form}"
    path.write_bytes(whole[form][: len(whole[form]) // 2])
    error = refuse(path)
    assert "truncated or damaged" in error.what
    assert capfd.readouterr() == ("", "")  # what C libraries print stays out of the terminal


@pytest.mark.parametrize("form", ["jpg", "png", "tif", "dng"])
@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(share=st.floats(0.0, 1.0))
def test_a_file_cut_anywhere_is_read_or_refused(tmp_path, whole, form, share):
    path = tmp_path / f"cut.{form}"
    path.write_bytes(whole[form][: int(share * len(whole[form]))])
    read_or_refuse(path)


@pytest.mark.parametrize("form", ["jpg", "png", "tif", "dng"])
@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(place=st.floats(0.0, 1.0), junk=st.binary(min_size=1, max_size=8), near_start=st.booleans())
def test_a_file_with_junk_is_read_or_refused(tmp_path, whole, form, place, junk, near_start):
    data = bytearray(whole[form])
    at = int(place * (min(400, len(data) - 8) if near_start else len(data) - 8))
    data[at : at + len(junk)] = junk
    path = tmp_path / f"junk.{form}"
    path.write_bytes(data)
    read_or_refuse(path)


def read_or_refuse(path: Path) -> None:
    try:
        photo = load_photo(path)
    except MatcapError as error:
        assert str(path) in str(error)
        return
    assert isinstance(photo, Photo)
    assert np.isfinite(photo.pixels).all() and photo.pixels.min() >= 0.0


def test_what_is_not_supported_is_not_called_damaged(tmp_path, codes):
    """Whole files: a JPEG of 12 bits by its frame, lossless ones, TIFFs of rare codings, others."""
    Image.fromarray(codes).save(tmp_path / "a.jpg")
    data = (tmp_path / "a.jpg").read_bytes()
    frame = data.index(b"\xff\xc0")
    for marker, bits, word in ((0xC1, 12, "12 bits"), (0xC3, 8, "lossless")):
        changed = bytearray(data)
        changed[frame + 1], changed[frame + 4] = marker, bits
        (tmp_path / "b.jpg").write_bytes(changed)
        error = refuse(tmp_path / "b.jpg")
        assert word in error.what and "not supported" in error.what
    tifffile.imwrite(tmp_path / "a.tif", codes.astype(np.complex64), photometric="minisblack")
    assert "not supported" in refuse(tmp_path / "a.tif").what
    tifffile.imwrite(tmp_path / "b.tif", codes, photometric="rgb")
    with tifffile.TiffFile(tmp_path / "b.tif", mode="r+") as file:
        file.pages.first.tags["Compression"].overwrite(34925)  # LZMA
    assert "compression LZMA is not supported" in refuse(tmp_path / "b.tif").what
    heads = {"JPEG XL": b"\xff\x0a", "GIF": b"GIF89a"}
    for word, head in heads.items():
        (tmp_path / "c.jpg").write_bytes(head + bytes(100))
        assert word in refuse(tmp_path / "c.jpg").what


def test_bands_without_names_are_no_colours(tmp_path):
    bands = np.full((96, 128, 5), 100, np.uint8)
    tifffile.imwrite(tmp_path / "a.tif", bands, photometric="minisblack", planarconfig="contig")
    assert "5 bands" in refuse(tmp_path / "a.tif").what
