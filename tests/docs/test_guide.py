"""What the guide tells people to type; `python tests/docs/guide.py` runs all of it."""

from pathlib import Path

import guide
import pytest

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
    left_out = {start.split()[0] for start in guide.LEFT_OUT}
    assert left_out <= {"matcap", "pip", "python"}
    assert len(guide.pages()) >= 8
