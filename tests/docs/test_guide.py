"""What the pages of docs say: commands that run, tables, and what breaks a capture."""

import importlib.util
from pathlib import Path

import guide
import numpy as np
import pytest
from guide import ROOT
from lattice_tilt import tilt_about_x

from matcap.lab.bench.paper_tables import paper_page
from matcap.lab.experiment.results import read
from matcap.lab.simulate.photograph import PhoneCamera
from matcap.lab.simulate.write_jpeg import write_jpeg
from matcap.photo.inspect import inspect_photo
from matcap.photo.load import load_photo

# A batch runs as README has it, in tests/cli; test_learn.py parses all lines.
QUICKEST = ("relight.md", "view.md")


@pytest.fixture(scope="module")
def captured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the first page leaves its captures for the others."""
    return tmp_path_factory.mktemp("captured") / "out"


@pytest.mark.parametrize("page", QUICKEST)
def test_the_lines_of_a_page_run_and_leave_what_they_name(
    page: str, tmp_path: Path, captured: Path
) -> None:
    faults = [f"{line}: {wrong}" for line, wrong in guide.run(page, tmp_path, captured) if wrong]
    assert not faults


def test_no_line_is_left_out_without_a_reason() -> None:
    assert all(start.startswith("matcap ") for start in guide.LEFT_OUT)
    assert len(guide.pages()) >= 8


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


@pytest.mark.parametrize("degrees", [10.0, -6.0])
def test_a_pattern_shows_its_tilt(degrees):
    """Stripes whose upper end is turned towards the camera are wider there."""
    distance, rows, columns = 1.54, 600, 800
    y, x = np.mgrid[0:rows, 0:columns] * 2.0 / columns
    slope = np.tan(np.radians(degrees)) / distance
    at = (x - 1.0) * (1.0 - slope * (rows / columns - y))
    texture = sum(np.cos(2.0 * np.pi * each * at) for each in (9.0, 13.0, 22.0))
    texture += 0.1 * np.random.default_rng(0).standard_normal(texture.shape)
    assert tilt_about_x(texture.astype(np.float32), distance)[0] == pytest.approx(degrees, abs=1.0)


SCRIPT = Path(__file__).parents[2] / "docs" / "images" / "failing.py"
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
    assert worst == {SEEN[name]}


@pytest.mark.parametrize("name", UNSEEN)
def test_what_is_not_seen_before_is_not_refused(failing, name, tmp_path):
    """A limit: no period is looked for, nothing that is there once, and no spike."""
    found = inspected(failing, name, tmp_path)
    assert found.rating.fit
