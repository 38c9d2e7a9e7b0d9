"""`sweep.py` finds what it looks for, counts it and says so by its exit code."""

from dataclasses import replace

import pytest
import torch
from stable import reflectance, sweeps
from stable.edges.swept import Swept
from stable.reflectance import CASES, measure
from stable.sweeps import Row, StabilitySettings, markdown, run_stability, unstable
from sweep import main

from matcap.errors import MatcapError


@pytest.fixture
def few(monkeypatch):
    """Two cases of the reflectance, three photographs."""
    monkeypatch.setattr(sweeps, "CASES", {"roughness 1": CASES["roughness 1"]})
    hard = {"a": lambda *_: "a", "b": lambda *_: "b"}
    monkeypatch.setattr(sweeps, "HARD_PHOTOGRAPHS", hard)
    return StabilitySettings(draws=50, photographs=3, sets=0)


def outcome(error):
    def capture(*_):
        raise error

    return capture


def test_a_formula_that_fails_is_found(monkeypatch):
    def naive(diffuse, specular, roughness, normal, to_light, to_view):
        half = to_light + to_view
        return diffuse / torch.sqrt((half * half).sum(0, keepdim=True)) + 0.0 * (
            specular + roughness + normal[:1]
        )

    monkeypatch.setattr(reflectance, "cook_torrance", naive)
    found = measure(CASES["light opposed to view"], 100, seed=0)
    assert (found.draws, found.values, found.gradients) == (100, 100, 100)


def test_a_bug_counts_and_a_refusal_does_not(monkeypatch, few):
    monkeypatch.setattr(sweeps, "capture_array", outcome(IndexError("out of range")))
    rows = run_stability(few)
    assert [row.draws for row in rows[2:]] == [2, 1]
    assert [row.values for row in rows[2:]] == [2, 1]
    assert unstable(rows) == 3
    assert "IndexError: out of range" in markdown(rows, "sweep.py")
    monkeypatch.setattr(sweeps, "capture_array", outcome(MatcapError("the picture is bad")))
    rows = run_stability(few)
    assert unstable(rows) == 0
    assert "refused: the picture is bad" in markdown(rows, "sweep.py")


def test_sets_and_parts_are_swept_too(monkeypatch, few):
    monkeypatch.setattr(sweeps, "capture_set", outcome(ValueError("shapes differ")))
    monkeypatch.setattr(sweeps, "capture_part", outcome(MatcapError("too little is left")))
    monkeypatch.setattr(sweeps, "HARD_SETS", {"two": lambda *_: []})
    monkeypatch.setattr(sweeps, "HARD_PHOTOGRAPHS", {"an ordinary one": lambda *_: []})
    monkeypatch.setattr(
        sweeps,
        "WHOLES",
        {"set: two": sweeps.of_set("two"), "part: a corner": sweeps.of_part("a corner")},
    )
    rows = run_stability(replace(few, photographs=0, sets=3))
    assert [(row.case, row.draws, row.values) for row in rows[2:]] == [
        ("set: two", 2, 2),
        ("part: a corner", 1, 0),
    ]
    assert rows[2].where == "ValueError: shapes differ"
    assert rows[3].where == "refused: too little is left"


@pytest.mark.parametrize(("values", "broken", "code"), [(0, 0, 0), (1, 0, 4), (0, 2, 4)])
def test_the_command_prints_the_tables_and_answers_with_its_exit_code(
    monkeypatch, capsys, values, broken, code
):
    asked = []

    def run(settings, tell):
        asked.append(settings)
        tell("halfway")
        return [Row("a case", settings.draws, values, 0, "1e-7", "there")]

    def edges(draws, seed, tell):
        return {"meshes": Swept(draws, broken, 1, 2e-7, "a corner", 0.5)}

    monkeypatch.setattr("sweep.run_stability", run)
    monkeypatch.setattr("stable.edges.table.run_edges", edges)
    assert main(["--quick", "--photographs", "7"]) == code
    said = capsys.readouterr()
    assert said.err == "halfway\n"
    assert f"| a case | 5000 | {values} | 0 | 1e-7 | there |" in said.out
    assert f"| meshes | 200000 | {broken} | 1 | 2.0e-07 | 0.5 |" in said.out
    assert (asked[0].photographs, asked[0].relighting) == (7, 200_000)


def test_each_sweep_is_left_out_where_nothing_of_it_is_asked_for(monkeypatch, capsys):
    def never(*_):
        raise AssertionError

    monkeypatch.setattr("sweep.run_stability", never)
    monkeypatch.setattr("stable.edges.table.run_edges", never)
    nothing = ["--draws", "0", "--photographs", "0", "--sets", "0", "--relighting", "0"]
    assert main(nothing) == 0
