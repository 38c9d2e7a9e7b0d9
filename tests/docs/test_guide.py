"""What the pages of docs say: commands that run, and how a lattice shows its tilt."""

from pathlib import Path

import guide
import numpy as np
import pytest
from lattice_tilt import tilt_about_x

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


def test_most_pages_of_the_guide_have_lines_to_run() -> None:
    assert len(guide.pages()) >= 8


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
