"""What an experiment measures, skips and leaves out."""

import pytest

from matcap.errors import MatcapError, UsageError
from matcap_lab.experiment.results import Trial, append, read
from matcap_lab.experiment.runner import Configuration, Experiment, choose, run


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
    work = Sum()
    experiment = work.experiment(failing={"two": dark, 5: None})
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
