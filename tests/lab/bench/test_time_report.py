"""`matcap bench capture` and `matcap bench report`: what is run, skipped, drawn and said."""

import json
import math

import pytest
from PIL import Image

from matcap.capture.settings import PRESETS
from matcap.cli.main import main
from matcap.errors import MatcapError, UsageError
from matcap.lab.bench import capture
from matcap.lab.bench.capture import SUBJECTS, USUAL, WAYS, CaptureBench, run_capture_bench
from matcap.lab.bench.report import write_report
from matcap.lab.bench.table import Measurement, append, read


class FakeJudge:
    def __init__(self, subject, flash, quality, detail):
        self.detail = detail

    def judge(self, material):
        return self.detail / 1000.0, 1.5, 0.9


@pytest.fixture
def captures(monkeypatch):
    """Nothing is photographed, captured or judged; gives what would have been captured."""
    asked = []

    def run(photo, settings, method, material):
        asked.append((photo, settings, method))
        return float(len(asked)), 700.0

    def shot(specimen, camera, out):
        return out / f"{specimen.name}.dng", type("Shot", (), {"setup": None})

    monkeypatch.setattr(capture, "_in_own_process", run)
    monkeypatch.setattr(capture, "photograph", shot)
    monkeypatch.setattr(capture, "_Judge", FakeJudge)
    monkeypatch.setattr(capture.Material, "load", lambda path: None)
    return asked


def test_there_are_points_and_subjects_enough_for_a_front():
    assert len(USUAL) >= 20 and len(SUBJECTS) >= 8
    assert set(PRESETS) <= set(USUAL)
    assert {way.group for way in WAYS.values()} >= {
        "preset", "steps", "time", "window", "statistics", "precision", "prior", "decoder",
    }  # fmt: skip
    assert "paper's form" in WAYS and "paper's form" not in USUAL


def test_a_sweep_goes_on_where_it_was_stopped(captures, tmp_path):
    ways, subjects = ("draft", "detail 512"), ("leather", "varied-1")
    run_capture_bench(CaptureBench(tmp_path, ways[:1], subjects[:1]))
    found = run_capture_bench(CaptureBench(tmp_path, ways, subjects))
    assert len(captures) == len(found) == 4
    assert {m.key[1:] for m in found} == {(w, s, 0) for w in ways for s in subjects}
    # Each way has its own detail, and is judged by it.
    assert [m.error for m in found if m.point == "detail 512"] == [0.512, 0.512]
    assert [m.error for m in found if m.point == "draft"] == [1.024, 1.024]
    run_capture_bench(CaptureBench(tmp_path, ways, subjects))
    assert len(captures) == 4
    run_capture_bench(CaptureBench(tmp_path, ways[:1], subjects[:1], seeds=(0, 5)))
    assert [settings.seed for _, settings, _ in captures] == [0, 0, 0, 0, 5]


def test_steps_of_a_trial_take_the_place_of_every_ways_own(captures, tmp_path):
    run_capture_bench(CaptureBench(tmp_path, ("reference", "2 s"), ("tile",), steps=2))
    assert [settings.steps for _, settings, _ in captures] == [2, 2]


@pytest.mark.parametrize(("ways", "subjects"), [(("fast",), ()), (("draft",), ("wood",))])
def test_unknown_names_are_told_with_the_known_ones(captures, tmp_path, ways, subjects):
    with pytest.raises(UsageError, match="choose from"):
        run_capture_bench(CaptureBench(tmp_path, ways, subjects))
    assert captures == []


def some(path):
    for point, group, seconds, error in (
        ("draft", "preset", 8.0, 3.0),
        ("standard", "preset", 30.0, 2.8),
        ("320 steps", "steps", 25.0, 2.0),
    ):
        for subject in ("leather", "tile"):
            append(
                path,
                Measurement(
                    "capture", group, point, subject, seconds, 800.0, error, 1.5, 0.9, "a machine"
                ),
            )
    append(
        path,
        Measurement("step", "form", "paper's form", "512 x 384", 3.0, 900.0, math.nan, machine="m"),
    )


def test_the_page_says_what_is_on_the_front_and_which_preset_is_not(tmp_path):
    pytest.importorskip("matplotlib", reason="the extra bench is not installed")
    table, page = tmp_path / "bench" / "capture.csv", tmp_path / "docs" / "page.md"
    some(table)
    relight = tmp_path / "relight.json"
    scene = {"scene": "noon", "effects": 3, "automatic_s": 0.1, "all_s": 0.4, "ratio": 4.0}
    relight.write_text(
        json.dumps({"megapixel_wall_ms": 50.0, "median_ratio": 4.0, "scenes": [scene]})
    )
    text = write_report([table, relight], page, ["matcap", "bench", "report"])
    assert page.read_text() == text
    assert "On a machine." in text
    assert "| * | preset | draft | 2 | 8 | 800 | 3 | 0 | 1.5 | 0.9 |" in text
    assert "preset `draft`: dominated by no other point." in text
    assert "preset `standard`: dominated by 320 steps." in text
    assert "(../bench/capture.png)" in text
    assert "| paper's form | 3 | 900 |" in text
    assert "| noon | 3 | 0.100 | 0.400 | 4.0 |" in text
    with Image.open(table.with_suffix(".png")) as picture:
        assert picture.width > 600


def test_missing_and_empty_tables_are_told(tmp_path):
    with pytest.raises(MatcapError, match="no such table"):
        write_report([tmp_path / "none.csv"], tmp_path / "page.md", ["matcap"])
    empty = tmp_path / "empty.csv"
    empty.touch()
    with pytest.raises(MatcapError, match="the table is empty"):
        write_report([empty], tmp_path / "page.md", ["matcap"])
    odd = tmp_path / "odd.json"
    odd.write_text("[]")
    with pytest.raises(MatcapError, match="not what matcap bench relight"):
        write_report([odd], tmp_path / "page.md", ["matcap"])
    assert not (tmp_path / "page.md").exists()


def test_the_command_lists_and_measures(captures, tmp_path, capsys):
    assert main(["bench", "capture", "--list"]) == 0
    listed = capsys.readouterr().out
    assert "point    preset     draft" in listed and "subject  varied-1" in listed
    arguments = ["--point", "draft", "--material", "tile", "-o", str(tmp_path / "b")]
    assert main(["bench", "capture", *arguments]) == 0
    assert "1 measurements" in capsys.readouterr().out
    assert [m.subject for m in read(tmp_path / "b" / "capture.csv")] == ["tile"]
