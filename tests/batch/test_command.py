"""The batch command: what it refuses, predicts and prints. test_run.py runs it for real."""

import io
import json

import pytest
from kills import make_shoot
from rich.console import Console
from rich.progress import Progress as Bars

from matcap.batch.run import prediction_text, prepare
from matcap.batch.samples import BatchSettings, Policy, ShotSample
from matcap.batch.work import BatchEntry, measured, photo_pixels, pool_size, recorded, worker_bytes
from matcap.capture.settings import PRESETS, CaptureSettings
from matcap.cli.display import BatchDisplay
from matcap.cli.main import main
from matcap.files.names import Progress
from matcap.photo.calibrate import Calibration

NO_BARS = Bars(disable=True)


@pytest.fixture
def shoot(tmp_path):
    make_shoot(tmp_path / "shoot", 1)
    return tmp_path / "shoot"


def test_a_dry_run_writes_nothing_and_forecasts_no_time(shoot, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["batch", str(shoot), "-o", str(out), "--dry-run", "--json", "-j", "1"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert (values["todo"], values["seconds"]) == (1, None)
    assert [row["status"] for row in values["materials"]] == ["to do"]
    assert values["materials"][0]["superseded"][0].endswith("leather.jpg") and not out.exists()
    assert main(["batch", str(shoot), "-o", str(out), "--dry-run"]) == 0
    text = capsys.readouterr().out
    assert "leather: to do" in text and "time unknown" in text and "GB of memory" in text
    (shoot / "void.jpg").touch()
    (shoot / "words.tif").write_text("words")
    assert main(["batch", str(shoot), "-o", str(out), "--dry-run"]) == 0
    text = capsys.readouterr().out
    assert "1 to capture" in text and "leather: to do" in text
    assert "void: cannot be used (" in text and "void.jpg: the file is empty" in text
    assert "words: cannot be used (" in text and "but a text file" in text
    (shoot / "leather.dng").write_text("words")
    assert main(["batch", str(shoot), "-o", str(out), "--dry-run"]) == 0
    assert "Nothing to do: 3 cannot be used." in capsys.readouterr().out
    rows = [{"status": "done"}, {"status": "failed"}]
    assert prediction_text({"todo": 0, "materials": rows}).endswith(
        "to do: 1 made before, 1 cannot be used."
    )


def test_a_forecast_is_of_materials_made_with_the_same_steps_and_detail(shoot, tmp_path, capsys):
    out = tmp_path / "out"
    for name, detail, seconds in (("a", 512, 20.0), ("b", 512, 40.0), ("c", 256, 1.0)):
        steps = PRESETS["standard"].decoder_steps
        about = {"identity": name, "steps": steps, "most_detail": detail, "seconds": seconds}
        with recorded(out / name, about):
            (out / name).mkdir(parents=True)
            (out / name / "maps.exr").write_bytes(bytes(1000))
    asked = ["batch", str(shoot), "-o", str(out), "--dry-run", "--json", "--detail", "512"]
    assert main(asked) == 0
    values = json.loads(capsys.readouterr().out)
    # The mean of those made, and 5 s in which the libraries are loaded.
    assert (values["seconds_each"], values["seconds"], values["disk_bytes"]) == (30.0, 35.0, 1000)
    assert values["measured"] == "measured on 2 made before"


@pytest.mark.parametrize(
    ("arguments", "code", "word"),
    [
        (["nowhere"], 3, "no such folder"),
        (["SHOOT", "--preset", "drafd"], 2, "'draft'"),
        (["SHOOT", "--size", "100", "--tile"], 2, "multiples of 16"),
        (["SHOOT", "--prior", "nothing.safetensors"], 2, "--generator decoder"),
        (["SHOOT", "--generator", "decoder", "--prior", "no.safetensors"], 3, "no such prior"),
    ],
)
def test_wrong_settings_are_reported_before_any_work(
    shoot, tmp_path, capsys, arguments, code, word
):
    arguments = [str(shoot) if a == "SHOOT" else a for a in arguments]
    assert main(["batch", *arguments, "-o", str(tmp_path / "out")]) == code
    assert word in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_fewer_workers_where_memory_or_work_is_short(monkeypatch):
    for free, wanted, jobs, size in (
        (100_000, 4, 10, 4),
        (100_000, 4, 2, 2),
        (2_500, 4, 10, 2),
        (10, 4, 10, 1),
    ):
        monkeypatch.setattr("matcap.batch.work.free_bytes", lambda free=free: free)
        assert pool_size(wanted, 1_000, jobs) == size
    assert pool_size(None, 1, 1_000) >= 1


def test_memory_grows_with_photograph_detail_and_map_set(shoot):
    base = worker_bytes(BatchSettings(), 12_000_000, raw=False)
    assert worker_bytes(BatchSettings(), 48_000_000, raw=False) > base
    assert worker_bytes(BatchSettings(), 12_000_000, raw=True) > base
    fine, usual = (BatchSettings.of({"detail": texels}) for texels in (4000, 1024))
    assert worker_bytes(fine, 12_000_000, raw=False) > base
    assert worker_bytes(usual, 12_000_000, raw=False) < base
    assert worker_bytes(BatchSettings.of({"size": (4096, 4096)}), 12_000_000, raw=False) > base
    assert photo_pixels(shoot / "leather.jpg") == (128 * 96, False)
    assert photo_pixels(shoot / "leather.dng") == (128 * 96, True)


def test_without_a_terminal_each_finished_sample_prints_a_line(tmp_path):
    said = io.StringIO()
    shown = BatchDisplay(Console(file=said, width=200), NO_BARS, quiet=False)
    shown.expect(2)
    record = {"verdict": {"rating": "usable"}, "doubtful": True, "seconds": 12.0}
    good = BatchEntry(ShotSample("a [b]", (tmp_path / "a.jpg",)), "i", "made", "", record)
    bad = BatchEntry(ShotSample("c", (tmp_path / "c.jpg",)), "i", "failed", "black.")
    for entry in (good, bad):
        shown.started(entry)
        shown.progress(entry, Progress("fine-tuning", 0.5))
        shown.ended(entry)
    lines = said.getvalue().splitlines()
    assert lines[0].startswith("[1/2] a [b]: 12 s, usable, doubtful shot") and "left" in lines[0]
    assert lines[1] == "[2/2] c: failed"


def test_a_calibration_card_is_no_sample_and_part_of_the_identity(shoot, tmp_path, monkeypatch):
    seen = []

    def read(path, fov=None):
        seen.append(path.name)
        return Calibration(path.name, "digest", millimetres_per_unit=120.0, tilt=1.0)

    monkeypatch.setattr("matcap.batch.run.read_card", read)
    shown = BatchDisplay(Console(file=io.StringIO()), NO_BARS, quiet=True)
    without = prepare(shoot, tmp_path / "out", BatchSettings(), Policy(), shown)
    (shoot / "Card 1.dng").write_bytes(b"x")
    (shoot / "Card 1.jpg").write_bytes(b"x")
    card = prepare(shoot, tmp_path / "out", BatchSettings(), Policy(), shown)
    assert seen == ["Card 1.dng"] and [entry.sample.name for entry in card.entries] == ["leather"]
    assert card.entries[0].identity != without.entries[0].identity
    none = prepare(shoot, tmp_path / "out", BatchSettings(card="none"), Policy(), shown)
    assert len(none.entries) == 2


def test_the_cards_scale_becomes_the_materials():
    card = Calibration("card.dng", "digest", millimetres_per_unit=120.0)
    assert measured(CaptureSettings(), card).millimetres_per_unit == 120.0
    assert measured(CaptureSettings(width_cm=10.0), card).millimetres_per_unit == 50.0
    for silent in (None, Calibration("card.dng", "digest")):
        assert measured(CaptureSettings(), silent).millimetres_per_unit is None
