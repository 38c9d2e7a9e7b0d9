"""The output folder of a batch: claims, records, index."""

import json
import os
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

from matcap.batch.overview import write_index
from matcap.batch.samples import WORKSPACE, ShotSample
from matcap.batch.work import FILE, BatchEntry, is_done, open_run, read_failure, write_record
from matcap.errors import MatcapError

# Folders that appear whole, records that say what is done, and the lock of a run.


def make(run, name, text, identity="i"):
    """A stage with a file and a record, published."""
    stage = run.stage(name)
    (stage / "preview.png").write_text(text)
    write_record(stage, {"identity": identity})
    return run.publish(stage)


def dead_run(out):
    """The folder of a run that was killed while it had a stage."""
    code = (
        "import os, sys, pathlib, matcap.batch.work as w\n"
        "opened = w.open_run(pathlib.Path(sys.argv[1]))\n"
        "run = opened.__enter__()\n"
        "run.stage('a'); os.kill(os.getpid(), 9)\n"
    )
    subprocess.run([sys.executable, "-c", code, str(out)])
    return out / WORKSPACE / "run"


def test_a_material_is_done_if_its_files_and_identity_match(tmp_path):
    with open_run(tmp_path) as run:
        folder = make(run, "a", "picture")
        assert is_done(folder, "i")
        assert not is_done(folder, "another")
    (folder / "preview.png").write_text("pict")
    assert not is_done(folder, "i")
    (folder / "preview.png").unlink()
    assert not is_done(folder, "i")


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": "matcap batch record"}', "[" * 9999])
def test_a_record_that_cannot_be_read_is_none(tmp_path, text):
    (tmp_path / FILE).write_text(text)
    assert not is_done(tmp_path, "i")


def test_a_second_capture_replaces_the_first_and_keeps_foreign_files(tmp_path):
    with open_run(tmp_path) as run:
        stage = run.stage("a")
        (stage / "a_extra.png").write_text("of the first only")
        (stage / "preview.png").write_text("first")
        write_record(stage, {"identity": "1"})
        folder = run.publish(stage)
        (folder / "my notes.txt").write_text("keep")
        make(run, "a", "second", "2")
        assert sorted(os.listdir(folder)) == [FILE, "my notes.txt", "preview.png"]
        assert (folder / "preview.png").read_text() == "second"
        assert is_done(folder, "2")
    assert os.listdir(tmp_path / WORKSPACE) == ["lock"]


def test_files_of_a_plain_capture_are_replaced(tmp_path):
    (tmp_path / "a").mkdir()
    for name in ("a_diffuse.png", "report.json", "a.matcap", "other.txt"):
        (tmp_path / "a" / name).write_text("old")
    with open_run(tmp_path) as run:
        folder = make(run, "a", "new")
    assert sorted(os.listdir(folder)) == [FILE, "other.txt", "preview.png"]


def test_a_file_in_the_place_of_a_folder_is_left_alone(tmp_path):
    (tmp_path / "a").write_text("mine")
    with open_run(tmp_path) as run, pytest.raises(OSError):
        make(run, "a", "new")
    assert (tmp_path / "a").read_text() == "mine"


def test_a_second_run_is_refused_while_the_first_lives(tmp_path):
    with open_run(tmp_path) as run:
        stage = run.stage("a")
        with pytest.raises(MatcapError, match="another matcap batch"), open_run(tmp_path):
            pass
        assert stage.is_dir()


def test_staged_folders_of_a_killed_run_are_deleted(tmp_path):
    dead = dead_run(tmp_path)
    assert list(dead.rglob("a"))
    with open_run(tmp_path):
        assert not list(dead.rglob("a"))


def test_folders_that_a_killed_run_had_moved_are_restored(tmp_path):
    """Killed between the two renames, or before it had put back what others left there."""
    dead = dead_run(tmp_path)
    for number, name in enumerate(("gone", "here")):
        old = dead / "old" / str(number) / name
        old.mkdir(parents=True)
        (old / "preview.png").write_text("old")
        (old / "notes.txt").write_text("keep")
    (tmp_path / "here").mkdir()
    (tmp_path / "here/preview.png").write_text("new")
    with open_run(tmp_path):
        pass
    assert sorted(os.listdir(tmp_path / "gone")) == ["notes.txt", "preview.png"]
    assert (tmp_path / "here/notes.txt").read_text() == "keep"
    assert (tmp_path / "here/preview.png").read_text() == "new"


def test_the_old_folder_is_restored_when_the_new_one_cannot_be_renamed(tmp_path, monkeypatch):
    rename = os.rename
    with open_run(tmp_path) as run:
        folder = make(run, "a", "first")
        (folder / "notes.txt").write_text("keep")

        def no_stage(source, target):
            if run.folder / "stage" in source.parents and not os.path.exists(target):
                raise OSError(5, "Input/output error")
            rename(source, target)

        monkeypatch.setattr(os, "rename", no_stage)
        with pytest.raises(OSError, match="Input/output"):
            make(run, "a", "second")
        assert (folder / "preview.png").read_text() == "first"
        assert (folder / "notes.txt").read_text() == "keep"


def test_foreign_files_survive_a_failure_to_move_them(tmp_path, monkeypatch):
    rename = os.rename
    with open_run(tmp_path) as run:
        folder = make(run, "a", "first")
        (folder / "notes.txt").write_text("keep")

        def no_notes(source, target):
            if source.name == "notes.txt":
                raise OSError(5, "Input/output error")
            rename(source, target)

        monkeypatch.setattr(os, "rename", no_notes)
        with pytest.raises(OSError, match="Input/output"):
            make(run, "a", "second")
    assert (folder / "preview.png").read_text() == "second"
    assert not (folder / "notes.txt").exists()
    monkeypatch.undo()
    with open_run(tmp_path):
        assert (folder / "notes.txt").read_text() == "keep"


def test_failures_are_recorded_and_removed(tmp_path):
    with open_run(tmp_path) as run:
        run.write_failure("a", {"identity": "i", "reason": "black"})
        assert read_failure(tmp_path, "a") == {"identity": "i", "reason": "black"}
        run.forget_failure("a")
        assert read_failure(tmp_path, "a") is None
    (tmp_path / WORKSPACE / "failed" / "b").write_text("{torn")
    assert read_failure(tmp_path, "b") is None


# The page and its tables.

RECORD = {
    "identity": "i", "photographs": ["/shoot/a & b.jpg"], "relative_error": 0.5,
    "tilt_degrees": [0.0, -7.5], "verdict": {"rating": "usable", "severity": 1.5},
    "clipped": 0.021, "doubtful": True, "seconds": 75.0, "detail": 512,
    "warnings": ["2.1 % of the picture is clipped. Lower the exposure by one stop."],
    "notes": ["The file states no white balance: daylight (D65) assumed."],
    "thumbnails": {"photograph": "AAAA", "height: -1 to 1": "BBBB"},
}  # fmt: skip


class Reader(HTMLParser):
    """Rows of the table, and whatever would be fetched."""

    def __init__(self):
        super().__init__()
        self.rows, self.sources, self.tags = 0, [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.rows += tag == "tr"
        for name, value in attrs:
            if name in ("src", "href", "data", "action") and tag != "a":
                self.sources.append(value)
            assert not name.startswith("on")


def written(tmp_path):
    entries = []
    for name, state, reason in (
        ("good", "made", ""),
        ("<script>alert(1)</script>", "failed", '=cmd|"x": <b>black</b>; use the flash.'),
        ("late", "left", "interrupted"),
    ):
        record = {}
        if state == "made":
            record = RECORD
            (tmp_path / name).mkdir()
            write_record(tmp_path / name, record)
        sample = ShotSample(name, (Path(f"/shoot/{state}.jpg"),))
        entries.append(BatchEntry(sample, "i", state, reason, dict(record)))
    (tmp_path / "earlier").mkdir()
    write_record(tmp_path / "earlier", {**RECORD, "doubtful": False})
    write_index(tmp_path, entries)
    return tmp_path


def test_the_page_fetches_nothing_and_escapes_everything(tmp_path):
    page = (written(tmp_path) / "index.html").read_text()
    reader = Reader()
    reader.feed(page)
    assert reader.rows == 1 + 4
    assert reader.sources and all(source.startswith("data:image/jpeg") for source in reader.sources)
    assert reader.tags.count("script") == 1 and "b" not in reader.tags
    assert "http://" not in page and "https://" not in page and "@ROWS@" not in page


def test_notes_of_reading_are_shown(tmp_path):
    written(tmp_path)
    assert "<li>The file states no white balance: daylight" in (tmp_path / "index.html").read_text()


def test_the_table_holds_every_material(tmp_path):
    written(tmp_path)
    rows = json.loads((tmp_path / "index.json").read_text())["materials"]
    assert [(row["name"], row["state"]) for row in rows] == [
        ("good", "done"),
        ("<script>alert(1)</script>", "failed"),
        ("late", "not begun"),
        ("earlier", "done"),
    ]
    assert rows[0]["tilt_y"] == -7.5 and rows[1]["reason"].startswith("=cmd")


def test_doubtful_shots_are_marked(tmp_path):
    page = (written(tmp_path) / "index.html").read_text()
    assert page.count('<tr class="doubtful">') == 1 and page.count('<tr class="done">') == 1
    assert 'data-key="7.5"' in page and "Lower the exposure" in page


def test_a_material_that_failed_in_the_verdict_is_red(tmp_path):
    folder = tmp_path / "lost"
    folder.mkdir()
    record = {**RECORD, "doubtful": True, "verdict": {"rating": "failed", "severity": 4.2}}
    write_record(folder, record)
    write_index(tmp_path, [])
    page = (tmp_path / "index.html").read_text()
    assert page.count('<tr class="failed">') == 1 and "0 doubtful · 1 failed" in page
    assert '<a class="verdict failed" href="lost/report.json">' in page
    (row,) = json.loads((tmp_path / "index.json").read_text())["materials"]
    assert (row["state"], row["verdict"], row["severity"]) == ("done", "failed", 4.2)


def test_the_index_links_verdict_maps_and_view_command(tmp_path):
    page = (written(tmp_path) / "index.html").read_text()
    for name in ("good", "earlier"):
        assert f'href="{name}/report.json">usable' in page and f'href="{name}/">maps' in page
        assert f"<code>matcap view ./{name}</code>" in page
    assert page.count("matcap view") == 2  # what was not made cannot be viewed
