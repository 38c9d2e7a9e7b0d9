"""Sizes, rectangles, times and names as typed or found in files."""

import random

import pytest

from matcap.errors import MatcapError, UsageError
from matcap.files.names import StagedFolder, name_fault, plain_name, sanitised_name, usable_name
from matcap.files.output import Output
from matcap.files.values import Rectangle, Size, duration, region, size

NASTY = (
    "", " ", ".", "..", ".hidden", "../keep", "../../victim/keep", "/etc/passwd", "a/b", "a\\b",
    "a\0b", "a\nb", "a\x1b[2Jb", "a\u202eb", "\ud800", "x" * 201, "é" * 150,
)  # fmt: skip
FINE = ("leather", "Leather (2), brown", "dose & co", "Holz'stück", "木目", "a.b", "x" * 200)


@pytest.mark.parametrize("name", NASTY)
def test_a_nasty_name_is_refused_and_becomes_a_plain_one(name):
    with pytest.raises(UsageError, match="is not a plain file name: it") as caught:
        plain_name(name)
    assert caught.value.sentence().isprintable()
    assert name_fault(sanitised_name(name)) == name_fault(usable_name(name)) == ""


@pytest.mark.parametrize("name", FINE)
def test_a_name_that_people_give_is_kept(name):
    assert plain_name(name) == usable_name(name) == name


@pytest.mark.parametrize("name", [3, None, ["a"], b"a"])
def test_what_is_no_text_is_no_name(name):
    assert name_fault(name) == "is no text"


@pytest.mark.parametrize("name", ["../keep", "..", "/etc/passwd", "a/../../b", "", "."])
def test_nothing_is_staged_outside_its_folder(tmp_path, name):
    (tmp_path / "keep").write_text("mine")
    with (
        pytest.raises(MatcapError, match="leads out of the folder"),
        Output(tmp_path / "out").stage() as stage,
    ):
        (stage / name).write_text("theirs")
    assert [file.name for file in tmp_path.iterdir()] == ["keep"]
    assert (tmp_path / "keep").read_text() == "mine"


def test_ten_thousand_names_are_plain_once_made_so(tmp_path):
    chance = random.Random(1)
    alphabet = "ab/\\.\0\n\r\t\x1b\u202e\u2028 é木-_:*?\"<>|~$'`{}%&#@"
    stage = StagedFolder(tmp_path)
    for _ in range(10_000):
        name = "".join(chance.choice(alphabet) for _ in range(chance.randrange(12)))
        plain = sanitised_name(name)
        assert name_fault(plain) == "" and (stage / plain).parent == tmp_path
        if name_fault(name) == "":
            assert (stage / name).parent == tmp_path


def test_sizes():
    assert size("4096x256") == Size(4096, 256)
    assert size("512") == Size(512, 512)
    assert size("2K") == Size(2048, 2048) and size("4kx512") == Size(4096, 512)
    assert size(str(Size(3, 4))) == Size(3, 4)


def test_regions():
    assert region("-100,0,512,256") == Rectangle(-100, 0, 512, 256)
    assert region(f"{2**40 - 8},{-(2**40)},8,8") == Rectangle(2**40 - 8, -(2**40), 8, 8)


@pytest.mark.parametrize(
    ("text", "seconds"), [("90", 90), ("20s", 20), ("1.5m", 90), ("2h", 7200), (".5", 0.5)]
)
def test_durations(text, seconds):
    assert duration(text) == seconds


WRONG = {
    size: ("", "x", "4x", "x4", "4x0", "0", "-4x4", "4.5x4", "4x4x4", "1e3"),
    region: ("", "1,2,3", "1,2,3,x", "0,0,0,5", "0,0,5,-5", f"{2**40},0,1,1"),
    duration: ("", "0", "-1", "s", "1d", "nan", "inf", "1e3", "9" * 400),
}


@pytest.mark.parametrize(("read", "text"), [(read, text) for read in WRONG for text in WRONG[read]])
def test_what_is_no_value_is_named(read, text):
    with pytest.raises(ValueError, match=r"^'.*' "):
        read(text)
