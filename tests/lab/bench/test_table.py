"""The table of measurements: kept through kills, averaged, and its Pareto front."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from matcap.errors import MatcapError
from matcap.lab.bench.table import Measurement, Point, append, comparable, front, points, read


def measured(point="draft", subject="leather", seconds=1.0, error=2.0, group="preset"):
    return Measurement("capture", group, point, subject, seconds, 800.0, error, machine="a, b")


def test_what_is_appended_is_read(tmp_path):
    path = tmp_path / "new" / "capture.csv"
    lines = [measured(), measured(subject="tile", error=3.5)]
    for line in lines:
        append(path, line)
    found = read(path)
    assert [(m.key, m.seconds, m.error, m.machine) for m in found] == [
        (m.key, m.seconds, m.error, m.machine) for m in lines
    ]
    assert math.isnan(found[0].flash)
    assert read(tmp_path / "none.csv") == []


@pytest.mark.parametrize("cut", [1, 5, 20])
def test_a_line_torn_by_a_kill_is_measured_again(tmp_path, cut):
    path = tmp_path / "capture.csv"
    append(path, measured())
    append(path, measured(subject="tile"))
    path.write_bytes(path.read_bytes()[:-cut])
    assert [m.subject for m in read(path)] == ["leather"]
    append(path, measured(subject="tile"))
    assert [m.subject for m in read(path)] == ["leather", "tile"]


@pytest.mark.parametrize("text", ["a,b\n1,2\n", "bench,group\nx,y\n"])
def test_another_table_is_refused(tmp_path, text):
    path = tmp_path / "other.csv"
    path.write_text(text)
    with pytest.raises(MatcapError, match="not a table of measurements"):
        read(path)


def test_points_are_means_over_subjects_and_the_last_measurement_counts():
    lines = [measured(error=9.0), measured(error=2.0), measured(subject="tile", error=4.0)]
    (point,) = points(lines)
    assert (point.subjects, point.error, point.spread, point.seconds) == (2, 3.0, 1.0, 1.0)
    assert math.isnan(point.flash)


def test_seeds_scatter_within_a_subject_and_subjects_spread():
    lines = [replace(measured(error=error), seed=seed) for seed, error in enumerate((1.0, 3.0))]
    lines += [replace(measured(subject="tile", error=6.0), seed=seed) for seed in (0, 1)]
    (point,) = points(lines)
    assert (point.seeds, point.subjects, point.error) == (2, 2, 4.0)
    assert (point.spread, point.scatter) == (2.0, 0.5)
    (alone,) = points(lines[:1])
    assert alone.seeds == 1
    assert math.isnan(alone.scatter)


def test_a_table_without_seeds_is_read(tmp_path):
    path = tmp_path / "capture.csv"
    append(path, measured())
    older = [",".join(line.split(",")[:7]) for line in path.read_text().splitlines()]
    path.write_text("\n".join(older) + "\n")
    (one,) = read(path)
    assert (one.seed, one.error, one.verdict) == (0, 2.0, "")
    assert math.isnan(one.piece)


def test_a_point_of_fewer_subjects_is_told_by_its_ratio_on_the_same_ones():
    lines = [
        measured(point="base", subject="easy", error=1.0, seconds=10.0),
        measured(point="base", subject="hard", error=3.0, seconds=30.0),
        measured(point="other", subject="hard", error=1.5, seconds=60.0),
    ]
    base, other = points(lines, "base")
    assert (base.error, base.seconds) == (2.0, 20.0)
    assert (other.error, other.seconds, other.subjects) == (1.0, 40.0, 1)
    plain = points(lines)[1]
    assert (plain.error, plain.seconds) == (1.5, 60.0)


def a_point(name, seconds, error, subjects=8):
    return Point("steps", name, subjects, seconds, 0.0, error, 0.0)


def test_a_point_of_fewer_subjects_is_not_on_the_front():
    lucky = a_point("lucky", 1.0, 0.1, subjects=1)
    assert [p.name for p in front(comparable([lucky, a_point("a", 2.0, 1.0)]))] == ["a"]


@given(st.lists(st.tuples(st.floats(0.1, 100), st.floats(0.1, 100)), min_size=1, max_size=12))
def test_nothing_beats_the_front_and_the_front_beats_the_rest(values):
    found = [a_point(str(i), s, e) for i, (s, e) in enumerate(values)]
    best = front(found)
    for point in found:
        beaten = [p for p in found if p.seconds <= point.seconds and p.error < point.error]
        if point in best:
            assert not beaten
        else:
            assert any(p.seconds <= point.seconds and p.error <= point.error for p in best)
