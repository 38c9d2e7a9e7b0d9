"""`matcap compare`: a picture of two captures, and their verdicts."""

import json

import cv2
import numpy as np
import pytest
from materials import a_material
from PIL import Image

from matcap.capture.preview import titled


@pytest.fixture
def captures(tmp_path):
    """Two captures' folders, the second without a report."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        a_material(name, across=256).save(tmp_path / name / f"{name}.matcap")
    verdict = {"rating": "doubtful", "sentence": "doubtful: the highlight is lost"}
    report = {"format": "matcap report", "verdict": verdict}
    (tmp_path / "a" / "report.json").write_text(json.dumps(report))
    return tmp_path


def test_two_captures_stand_above_each_other_with_their_verdicts(matcap, captures):
    picture = captures / "both.png"
    said = matcap("compare", captures / "a", captures / "b" / "b.matcap", "-o", picture)
    assert said.code == 0
    assert "a: doubtful: the highlight is lost" in said.err and "b: without a verdict" in said.err
    with Image.open(picture) as sheet:
        assert sheet.width > 4 * 500 and sheet.height > 2 * 700


def test_a_photograph_stands_beside_both(matcap, captures):
    grey = np.full((192, 256, 3), 128, np.uint8)
    cv2.imwrite(str(captures / "photo.png"), grey)
    one, two = captures / "one.png", captures / "two.png"
    assert matcap("compare", captures / "a", captures / "b", "-o", one).code == 0
    options = ("--photo", captures / "photo.png", "-o", two)
    assert matcap("compare", captures / "a", captures / "b", *options).code == 0
    with Image.open(one) as before, Image.open(two) as after:
        assert before.tobytes() != after.tobytes()


def test_what_is_no_capture_is_refused(matcap, captures):
    said = matcap("compare", captures / "a", captures / "none")
    assert said.code == 3 and "there is no such file" in said.err


def test_the_photograph_that_a_report_names_is_shown_or_said_to_be_gone(matcap, captures):
    file = captures / "taken.png"
    cv2.imwrite(str(file), np.full((192, 256, 3), 128, np.uint8))
    report = {"format": "matcap report", "photograph": {"path": str(file)}}
    (captures / "a" / "report.json").write_text(json.dumps(report))
    one, two, three = (captures / f"{name}.png" for name in ("own", "given", "gone"))
    (captures / "b" / "report.json").write_text(json.dumps(report))
    assert matcap("compare", captures / "a", captures / "b", "-o", one).code == 0
    options = ("--photo", file, "-o", two)
    assert matcap("compare", captures / "a", captures / "b", *options).code == 0
    with Image.open(one) as own, Image.open(two) as given:
        assert own.tobytes() == given.tobytes()
    file.unlink()
    said = matcap("compare", captures / "a", captures / "b", "-o", three)
    assert said.code == 0 and f"a: its photograph {file} does not exist" in said.err
    with Image.open(one) as own, Image.open(three) as gone:
        assert own.tobytes() != gone.tobytes()


def test_a_long_title_is_whole():
    """A verdict takes several lines rather than be cut off."""
    shown = Image.new("RGB", (600, 40))
    short, long = titled(shown, "leather: good"), titled(shown, "leather: doubtful, " + "so " * 80)
    assert short.height < long.height and short.width == long.width == 600
    ink = np.asarray(long)[:, -12:] != np.asarray(long)[0, 0]
    assert not ink[: long.height - 40].any()
