"""`matcap bench`: what the command hands to the measurement and prints of it."""

from types import SimpleNamespace

import pytest

from matcap.capture import pipeline
from matcap.errors import MatcapError
from matcap.lab.bench.quality import Score


@pytest.fixture
def measured(monkeypatch):
    """Replaces the measurement; gives the list of its calls."""
    calls = []

    def run(capture, out, **options):
        calls.append((capture, out, options))
        options["tell"]("halfway")
        return [Score("granite", "capture", 1.5, 2.5, 60.0)]

    monkeypatch.setattr("matcap.lab.bench.quality.run_quality", run)
    return calls


def test_the_table_is_printed_and_written(matcap, measured, tmp_path, monkeypatch):
    said = matcap(
        "bench", "quality", "-o", tmp_path / "q", "--material", "granite", "--detail", 256,
        "--preset", "draft",
    )  # fmt: skip
    assert said.code == 0
    assert said.err == "halfway\n"
    assert "| granite | capture | 1.50 | 2.50 | 2.00 | 60 |" in said.out
    assert sorted(f.name for f in (tmp_path / "q").iterdir()) == ["quality.csv", "quality.md"]
    ((capture, out, options),) = measured
    assert out == tmp_path / "q"
    assert options["materials"] == ["granite"]
    assert options["settings"].detail == 256
    monkeypatch.setattr(
        pipeline, "capture_file", lambda path, settings: SimpleNamespace(material=settings)
    )
    captured = capture(tmp_path / "photo.dng")
    assert (captured.preset, captured.detail) == ("draft", 256)


def test_floors_are_printed_and_written(matcap, monkeypatch, tmp_path):
    from matcap.lab.floors.run import FloorRow, floors_csv

    row = FloorRow("leather", "piece", 4.3, 7.0, 11.0, 0.6, 0.2, 0.5, 0.48, 20.0)
    calls = []

    def run(chosen, out, settings, **options):
        calls.append((chosen, settings))
        return [row]

    monkeypatch.setattr("matcap.lab.floors.run.run_floors", run)
    said = matcap("bench", "floors", "leather", "--stops", "-0.67", "-o", tmp_path / "f")
    assert said.code == 0
    assert "| leather | piece | 4.30 | 7.0 / 11.0 | 0.60 / 0.20 | 0.50 / 0.48 | 20 |" in said.out
    assert (tmp_path / "f" / "floors.csv").read_text() == floors_csv([row])
    ((chosen, settings),) = calls
    assert [s.name for s in chosen] == ["leather"] and settings.stops == -0.67
    assert "| mean | piece | 4.30 |" in said.out


def test_a_failed_capture_is_3(matcap, monkeypatch, tmp_path):
    def fail(*args, **kwargs):
        raise MatcapError("plenoptic is not installed", remedy='pip install "matcap[bench]"')

    monkeypatch.setattr("matcap.lab.bench.quality.run_quality", fail)
    said = matcap("bench", "quality", "-o", tmp_path / "q")
    assert (said.code, said.out) == (3, "")
    assert said.err == 'matcap: plenoptic is not installed; pip install "matcap[bench]".\n'
    assert list(tmp_path.iterdir()) == []


def test_bench_highlight_tells_what_was_kept_and_where_things_were(monkeypatch, matcap):
    """Only what is plain to see counts; nothing is fitted here."""
    from matcap.flash.highlight import Highlight
    from matcap.lab.bench import highlight as bench

    there = Highlight((0.0, 0.0), 0.2, 0.8, 0.1)
    again = Highlight((0.01, 0.0), 0.21, 0.8, 0.09)
    lost = bench.Kept("stone", there, None, 1.0)
    monkeypatch.setattr(
        bench, "simulated", lambda count, seed, tells_fov: [("gravel", None, None)] * count
    )
    monkeypatch.setattr(
        bench, "place", lambda kind, photo, truth: bench.Placed(kind, True, 0.02, 1.25)
    )
    assert bench.Kept("leather", there, again, 1.0).whole and not lost.whole
    assert "| stone | inf | 0.00 | 0.00 | no |" in bench.markdown([lost], [], "matcap bench")
    said = matcap("bench", "highlight", "--simulated", 2)
    assert said.code == 0
    assert "| all | 2 | 0.020 | 0.020 | 1.25° | 1.25° | 0 |" in said.out


def test_fields_of_true_maps_are_printed(matcap, monkeypatch):
    from matcap.lab.floors.fields import FieldRow

    row = FieldRow("leather", 1.0, 1.18, 1.2, 1.15, None, 0.01)
    asked = []
    monkeypatch.setattr(
        "matcap.lab.floors.fields.run_fields", lambda chosen, tell: asked.extend(chosen) or [row]
    )
    said = matcap("bench", "fields", "leather")
    assert said.code == 0 and [one.name for one in asked] == ["leather"]
    assert "| leather | 1 | 1.18 | 1.20 | 1.15 |  | 0.010 |" in said.out
    assert matcap("bench", "fields", "nothing").code == 2
