"""What pages of docs repeat of measurements, and photographs that break a capture."""

import importlib.util
from pathlib import Path

import pytest

from matcap.photo.inspect import inspect_photo
from matcap.photo.load import load_photo
from matcap_lab.bench.paper import paper_page
from matcap_lab.experiment.results import read
from matcap_lab.simulate.files import write_jpeg
from matcap_lab.simulate.photograph import PhoneCamera

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/guide/paper.md").read_text(encoding="utf-8")


def test_the_page_has_the_tables_that_bench_paper_makes_of_the_measured_rows():
    rows = read(ROOT / "docs/bench/paper.csv")
    experiments = {row.experiment for row in rows}
    assert experiments == {"paper", "interpolation", "generation"}
    captured = [row for row in rows if row.experiment == "paper"]
    assert {row.subject for row in captured} > {"leather", "granite", "asphalt10"}
    assert len(captured) == 11 * 3 + 3 * 5 + 2  # ablations of three, the paper's own system of one
    tables = [line for line in paper_page(rows, "").splitlines() if line.startswith("|")]
    assert len(tables) > 22
    assert [line for line in tables if line not in PAGE.splitlines()] == []


SCRIPT = ROOT / "docs" / "images" / "failing.py"
SEEN = {"painting": "stationarity", "no-flash": "flash", "lamp": "hot_spot"}
UNSEEN = ("check", "knot", "polished")


@pytest.fixture(scope="module")
def failing():
    """The script's photographs, by a camera of fewer pixels."""
    spec = importlib.util.spec_from_file_location("failing", SCRIPT)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    script.CAMERA = PhoneCamera(width=640, height=480, supersampling=1)
    return script


def inspected(failing, name, folder):
    file = folder / f"{name}.jpg"
    write_jpeg(file, failing.SHOTS[name](), 1)
    return inspect_photo(load_photo(file))


@pytest.mark.parametrize("name", SEEN)
def test_what_is_seen_before_is_told_apart(failing, name, tmp_path):
    found = inspected(failing, name, tmp_path)
    worst = {f.name for f in found.findings if not f.rating.fit}
    assert worst - {"subject"} == {SEEN[name]}  # a picture of things is no material, either


@pytest.mark.parametrize("name", UNSEEN)
def test_what_is_not_seen_before_is_not_refused(failing, name, tmp_path):
    """A limit: no period is looked for, nothing that is there once, and no spike."""
    assert inspected(failing, name, tmp_path).rating.fit
