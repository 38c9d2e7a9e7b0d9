"""The page and its tables."""

import json
from html.parser import HTMLParser
from pathlib import Path

from matcap.batch.entries import BatchEntry
from matcap.batch.input_folder import ShotSample
from matcap.batch.overview import write_index
from matcap.batch.record import write_record

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


def test_a_material_links_its_verdict_and_maps_and_says_how_to_view_it(tmp_path):
    page = (written(tmp_path) / "index.html").read_text()
    for name in ("good", "earlier"):
        assert f'href="{name}/report.json">usable' in page and f'href="{name}/">maps' in page
        assert f"<code>matcap view ./{name}</code>" in page
    assert page.count("matcap view") == 2  # what was not made cannot be viewed
