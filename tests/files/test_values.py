"""Sizes, rectangles and times as typed."""

import pytest

from matcap.files.values import Region, Size, duration, region, size


def test_sizes():
    assert size("4096x256") == Size(4096, 256)
    assert size("512") == Size(512, 512)
    assert size(str(Size(3, 4))) == Size(3, 4)


@pytest.mark.parametrize("text", ["", "x", "4x", "x4", "4x0", "0", "-4x4", "4.5x4", "4x4x4", "1e3"])
def test_wrong_sizes(text):
    with pytest.raises(ValueError, match=r"^'.*' "):
        size(text)


def test_regions():
    assert region("-100,0,512,256") == Region(-100, 0, 512, 256)
    assert region(f"{2**40 - 8},{-(2**40)},8,8") == Region(2**40 - 8, -(2**40), 8, 8)


@pytest.mark.parametrize("text", ["", "1,2,3", "1,2,3,x", "0,0,0,5", "0,0,5,-5", f"{2**40},0,1,1"])
def test_wrong_regions(text):
    with pytest.raises(ValueError, match=r"^'.*' "):
        region(text)


@pytest.mark.parametrize(
    ("text", "seconds"), [("90", 90), ("20s", 20), ("1.5m", 90), ("2h", 7200), (".5", 0.5)]
)
def test_durations(text, seconds):
    assert duration(text) == seconds


@pytest.mark.parametrize("text", ["", "0", "-1", "s", "1d", "nan", "inf", "1e3", "9" * 400])
def test_wrong_durations(text):
    with pytest.raises(ValueError, match=r"^'.*' "):
        duration(text)
