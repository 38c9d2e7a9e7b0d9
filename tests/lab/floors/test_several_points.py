"""What more photographs are worth, as points of a picture."""

import math
from dataclasses import replace

from matcap.lab.floors.run import FloorRow
from matcap.lab.floors.several import MapsOff, SeveralRow, several_markdown, several_points


def _row(material, count, floors, seconds):
    row = FloorRow(material, "", floors, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, seconds)
    return SeveralRow(row, count, 0, count, 0.0, 0.0, 0.0, 0.0, math.nan, math.nan)


def test_means_are_of_materials_that_have_every_count():
    rows = [
        _row("oak", 1, 2.0, 3.0), _row("oak", 5, 1.0, 30.0),
        _row("elm", 1, 4.0, 5.0), _row("elm", 5, 2.0, 50.0),
        _row("ash", 1, 9.0, 1.0),
    ]  # fmt: skip
    points = several_points(rows)
    means = [point for point in points if point.group == "mean"]
    assert [(one.name, one.error, one.seconds) for one in means] == [
        ("1 photographs", 3.0, 4.0),
        ("5 photographs", 1.5, 40.0),
    ]
    assert len(points) == 7
    assert [point.group for point in several_points(rows[:2])] == ["oak", "oak"]


def test_unions_are_told_apart_and_beyond_the_first_photograph():
    plain = _row("oak", 3, 2.0, 3.0)
    union = replace(plain, times=2.1, beyond=MapsOff(6.1, 9.5, 0.09, 0.06))
    told = several_markdown([plain, union], "matcap bench")
    assert "| oak | 3 |" in told and "| oak | 3, union |" in told
    assert "| oak | 3 | 2.10 | 6.1, 9.5 | 0.090 | 0.060 |" in told
    assert "Beyond" not in several_markdown([plain], "matcap bench")
