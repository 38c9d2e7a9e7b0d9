"""The output folder of a batch: claims, records, index."""

import json
import os
from html.parser import HTMLParser
from pathlib import Path

import pytest

from matcap.batch.overview import write_index
from matcap.batch.samples import WORKSPACE, ShotSample
from matcap.batch.work import (
    FILE,
    BatchEntry,
    forget_failure,
    is_done,
    open_run,
    read_failure,
    recorded,
    write_failure,
)
from matcap.errors import MatcapError
from matcap.files.output import Output

# Folders whose record says that they are whole, and the lock of a run.


def make(out, name, identity="i", **files):
    """A material of files by stem, and its record."""
    folder = out / name
    with recorded(folder, {"identity": identity}):
        for stem, text in files.items():
            with Output.file(folder / f"{stem}.png") as file:
                file.write_text(text)
    return folder


def test_a_material_is_done_if_its_files_and_identity_match(tmp_path):
    folder = make(tmp_path, "a", preview="picture")
    assert is_done(folder, "i") and not is_done(folder, "another")
    (folder / "preview.png").write_text("pict")
    assert not is_done(folder, "i")
    (folder / "preview.png").unlink()
    assert not is_done(folder, "i")


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": "matcap batch record"}', "[" * 9999])
def test_a_record_that_cannot_be_read_is_none(tmp_path, text):
    (tmp_path / FILE).write_text(text)
    assert not is_done(tmp_path, "i")


def test_a_second_capture_replaces_the_first_and_keeps_foreign_files(tmp_path):
    folder = make(tmp_path, "a", "1", preview="first", extra="of the first only")
    (folder / "notes.txt").write_text("keep")
    make(tmp_path, "a", "2", preview="second")
    assert sorted(os.listdir(folder)) == [FILE, "notes.txt", "preview.png"]
    assert (folder / "preview.png").read_text() == "second" and is_done(folder, "2")
    (folder / "notes.txt").unlink()
    assert is_done(folder, "2")


def test_an_interrupted_replacement_is_not_done(tmp_path):
    folder = make(tmp_path, "a", preview="first", maps="first")
    with pytest.raises(KeyboardInterrupt), recorded(folder, {"identity": "i"}):
        (folder / "preview.png").write_text("FIRST")
        raise KeyboardInterrupt
    assert not is_done(folder, "i") and (folder / "maps.png").read_text() == "first"


def test_a_replacement_that_fails_restores_the_files_and_is_made_again(tmp_path, monkeypatch):
    folder, replace = make(tmp_path, "a", preview="first", maps="first"), os.replace

    def second_fails(start, end):
        if Path(end) == folder / "preview.png":
            monkeypatch.undo()
            raise OSError(5, "Input/output error")
        replace(start, end)

    monkeypatch.setattr(os, "replace", second_fails)
    refused = pytest.raises(MatcapError, match="Input/output")
    with refused, recorded(folder, {"identity": "2"}), Output(folder).stage() as stage:
        for name in ("maps.png", "preview.png"):
            (stage / name).write_text("second")
    assert [(folder / f"{name}.png").read_text() for name in ("maps", "preview")] == ["first"] * 2
    assert sorted(os.listdir(folder)) == ["maps.png", "preview.png"] and not is_done(folder, "2")


def test_a_file_in_the_place_of_a_folder_is_left_alone(tmp_path):
    (tmp_path / "a").write_text("mine")
    with pytest.raises(OSError):
        make(tmp_path, "a", preview="new")
    assert (tmp_path / "a").read_text() == "mine"


def test_a_second_run_is_refused_while_the_first_lives(tmp_path):
    refused = pytest.raises(MatcapError, match="another matcap batch")
    with open_run(tmp_path), refused, open_run(tmp_path):
        pass


def test_hidden_folders_of_a_killed_run_are_deleted(tmp_path):
    (tmp_path / "a" / ".matcap-xyz").mkdir(parents=True)
    (tmp_path / "a" / ".matcap-xyz" / "half.png").write_text("half")
    (tmp_path / "other" / WORKSPACE).mkdir(parents=True)
    with open_run(tmp_path):
        assert not os.listdir(tmp_path / "a") and os.listdir(tmp_path / "other") == [WORKSPACE]


def test_failures_are_recorded_and_removed(tmp_path):
    write_failure(tmp_path, "a", {"identity": "i", "reason": "black"})
    assert read_failure(tmp_path, "a") == {"identity": "i", "reason": "black"}
    (tmp_path / WORKSPACE / "failed" / "b").write_text("{torn")
    assert read_failure(tmp_path, "b") is None
    forget_failure(tmp_path, "a")
    assert read_failure(tmp_path, "a") is None


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


def make_record(folder, about):
    with recorded(folder, dict(about)):
        pass


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
            make_record(tmp_path / name, record)
        sample = ShotSample(name, (Path(f"/shoot/{state}.jpg"),))
        entries.append(BatchEntry(sample, "i", state, reason, dict(record)))
    make_record(tmp_path / "earlier", RECORD | {"doubtful": False})
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
    assert "<li>The file states no white balance: daylight" in page  # a note of reading


def test_a_material_that_failed_in_the_verdict_is_red(tmp_path):
    verdict = {"rating": "failed", "severity": 4.2}
    make_record(tmp_path / "lost", RECORD | {"doubtful": True, "verdict": verdict})
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
