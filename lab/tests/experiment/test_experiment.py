"""Rows of measurements: kept through kills, averaged, and their Pareto front."""

import json
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from matcap.errors import MatcapError, UsageError
from matcap_lab.experiment.results import (
    Mean,
    Trial,
    append,
    as_json,
    comparable,
    front,
    means,
    read,
    table,
)
from matcap_lab.experiment.runner import Configuration, Experiment, choose, run


def trial(configuration="draft", subject="leather", seconds=1.0, error=2.0, **values):
    result = {"seconds": seconds, "error": error, **values}
    return Trial("nsd", configuration, subject, result, machine="a, b")


def test_what_is_appended_is_read(tmp_path):
    path = tmp_path / "new" / "nsd.csv"
    rows = [trial(verdict="good, or so"), trial(subject="tile", error=3.5, verdict="bad")]
    for row in rows:
        append(path, row)
    assert read(path) == rows
    assert math.isnan(read(path)[0].number("flash"))
    assert read(tmp_path / "none.csv") == []


def test_a_new_column_is_added_to_the_rows_that_are_there(tmp_path):
    path = tmp_path / "nsd.csv"
    append(path, trial())
    append(path, trial(subject="tile", flash=0.5))
    append(path, trial(subject="rust"))
    first, second, third = read(path)
    assert math.isnan(first.number("flash")) and first.number("error") == 2.0
    assert second.number("flash") == 0.5 and third.subject == "rust"


@pytest.mark.parametrize("cut", [1, 5, 20])
def test_a_line_torn_by_a_kill_is_measured_again(tmp_path, cut):
    path = tmp_path / "nsd.csv"
    append(path, trial())
    append(path, trial(subject="tile"))
    path.write_bytes(path.read_bytes()[:-cut])
    assert [row.subject for row in read(path)] == ["leather"]
    append(path, trial(subject="tile"))
    assert [row.subject for row in read(path)] == ["leather", "tile"]


@pytest.mark.parametrize("text", ["a,b\n1,2\n", "experiment,configuration\n,y\n"])
def test_another_table_is_refused(tmp_path, text):
    path = tmp_path / "other.csv"
    path.write_text(text)
    with pytest.raises(MatcapError, match="not a table of measurements"):
        read(path)


def test_means_are_over_subjects_and_the_last_row_counts():
    rows = [trial(error=9.0), trial(error=2.0), trial(subject="tile", error=4.0)]
    (mean,) = means(rows)
    assert (mean.subjects, mean["error"], mean.spread["error"], mean["seconds"]) == (2, 3.0, 1, 1)
    assert math.isnan(mean["flash"])


def test_an_infinite_error_has_no_spread():
    (mean,) = means([trial(error=1.0), trial(subject="tile", error=math.inf)])
    assert mean["error"] == math.inf
    assert math.isnan(mean.spread["error"])


def test_seeds_scatter_within_a_subject_and_subjects_spread():
    rows = [replace(trial(error=error), seed=seed) for seed, error in enumerate((1.0, 3.0))]
    rows += [replace(trial(subject="tile", error=6.0), seed=seed) for seed in (0, 1)]
    (mean,) = means(rows)
    assert (mean.seeds, mean.subjects, mean["error"]) == (2, 2, 4.0)
    assert (mean.spread["error"], mean.scatter["error"]) == (2.0, 0.5)
    (alone,) = means(rows[:1])
    assert alone.seeds == 1
    assert math.isnan(alone.scatter["error"])


def test_a_configuration_of_fewer_subjects_is_given_by_its_ratio_on_the_same_ones():
    rows = [
        trial("base", "easy", error=1.0, seconds=10.0),
        trial("base", "hard", error=3.0, seconds=30.0),
        trial("other", "hard", error=1.5, seconds=60.0),
    ]
    base, other = means(rows, "base")
    assert (base["error"], base["seconds"]) == (2.0, 20.0)
    assert (other["error"], other["seconds"], other.subjects) == (1.0, 40.0, 1)
    plain = means(rows)[1]
    assert (plain["error"], plain["seconds"]) == (1.5, 60.0)


def test_the_table_has_rows_means_and_the_command():
    rows = [trial(verdict="good"), trial(subject="tile", seconds=300.0, error=math.nan)]
    text = table(rows, "matcap-lab bench nsd", "What it is.")
    assert text.startswith("Measured by `matcap-lab bench nsd`.\n\nWhat it is.\n")
    assert "| leather | draft | 1.00 | 2.00 | good |" in text
    assert "| tile | draft | 300 |  |  |" in text
    assert "| mean | draft | 150 | 2.00 |  |" in text
    assert "mean" not in table(rows[:1], "")
    result = json.loads(as_json(rows))
    assert result[1]["error"] is None and result[0]["subject"] == "leather"


def a_mean(name, seconds, error, subjects=8):
    return Mean(name, "steps", subjects, 1, {"seconds": seconds, "error": error}, {}, {})


def test_a_configuration_of_fewer_subjects_is_not_on_the_front():
    lucky = a_mean("lucky", 1.0, 0.1, subjects=1)
    best = front(comparable([lucky, a_mean("a", 2.0, 1.0)]), "seconds", "error")
    assert [mean.configuration for mean in best] == ["a"]


@given(st.lists(st.tuples(st.floats(0.1, 100), st.floats(0.1, 100)), min_size=1, max_size=12))
def test_nothing_beats_the_front_and_the_front_beats_the_rest(values):
    found = [a_mean(str(i), s, e) for i, (s, e) in enumerate(values)]
    best = front(found, "seconds", "error")

    def beats(one, other):
        return one["seconds"] <= other["seconds"] and one["error"] < other["error"]

    for mean in found:
        if mean in best:
            assert not any(beats(other, mean) for other in found)
        else:
            assert any(
                one["seconds"] <= mean["seconds"] and one["error"] <= mean["error"] for one in best
            )


# What an experiment measures, skips and leaves out.


class Sum:
    """Of subjects 2 and 5 and configurations that add to them; counts what is done."""

    def __init__(self, **options):
        self.prepared, self.ran = [], []
        self.options = options

    def experiment(self, configurations=("one", "two"), failing=(), **options):
        def prepare(number):
            def prepared():
                self.prepared.append(number)
                if number in failing:
                    raise MatcapError("it is dark")
                return number

            return prepared

        def add(name):
            def added(number, seed):
                self.ran.append((number, name, seed))
                if name in failing:
                    raise failing[name]
                return number + {"one": 1, "two": 2}[name] + 100 * seed

            return added

        return Experiment(
            "sum",
            {"a": prepare(2), "b": prepare(5)},
            {name: Configuration(add(name), "adds") for name in configurations},
            (lambda number, total: {"total": float(total), "twice": 2.0 * number},),
            **{**self.options, **options},
        )


def test_every_configuration_of_every_subject_is_measured_once(tmp_path):
    work, table = Sum(), tmp_path / "sum.csv"
    (first,) = run(work.experiment(["one"], skips=lambda s, _c: s == "b"), table)
    assert (first.subject, first.number("total"), first.group) == ("a", 3.0, "adds")
    assert first.number("twice") == 4.0 and first.number("seconds") >= 0.0
    rows = run(work.experiment(), table)
    assert [(row.subject, row.configuration, row.number("total")) for row in rows] == [
        ("a", "one", 3.0), ("a", "two", 4.0), ("b", "one", 6.0), ("b", "two", 7.0)
    ]  # fmt: skip
    assert len(work.ran) == 4 and work.prepared == [2, 2, 5]
    run(work.experiment(), table)
    assert len(work.ran) == 4 and len(read(table)) == 4


def test_seeds_are_trials_of_their_own(tmp_path):
    rows = run(Sum().experiment(["one"], seeds=(0, 1)), tmp_path / "sum.csv")
    assert [row.number("total") for row in rows] == [3.0, 6.0, 103.0, 106.0]


def test_other_settings_are_measured_again_and_unknown_versions_count_where_they_may(tmp_path):
    work, table = Sum(), tmp_path / "sum.csv"
    run(work.experiment(["one"], settings="fine"), table)
    run(work.experiment(["one"], settings="coarse"), table)
    assert len(work.ran) == 4
    old = tmp_path / "old.csv"
    append(old, Trial("sum", "one", "a", {"total": 3.0}))
    rows = run(work.experiment(["one"], any_version=True), old)
    assert len(work.ran) == 5 and [row.version == "" for row in rows] == [True, False]


def test_what_fails_is_told_and_no_row(tmp_path):
    lines, dark = [], MatcapError("it has no light")
    experiment = Sum().experiment(failing={"two": dark, 5: None})
    rows = run(experiment, tmp_path / "sum.csv", lines.append)
    assert [(row.subject, row.configuration) for row in rows] == [("a", "one")]
    assert lines[1:] == ["a, two: it has no light.", "b: it is dark."]


def test_wrong_usage_ends_it_and_so_does_nothing_measured(tmp_path):
    wrong = {"one": UsageError("no such detail")}
    with pytest.raises(UsageError, match="no such detail"):
        run(Sum().experiment(failing=wrong), tmp_path / "sum.csv")
    nothing = {"one": MatcapError("no"), "two": MatcapError("no")}
    with pytest.raises(MatcapError, match="nothing could be measured"):
        run(Sum().experiment(failing=nothing), tmp_path / "sum.csv")


def test_names_are_chosen_or_told():
    assert choose({"a": 1, "b": 2}, ["b"]) == {"b": 2}
    assert choose({"a": 1, "b": 2}, []) == {"a": 1, "b": 2}
    with pytest.raises(UsageError, match="choose from a, b"):
        choose({"a": 1, "b": 2}, ["c"])
