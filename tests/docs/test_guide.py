"""What the guide tells people to type; `python tests/docs/guide.py` runs all of it."""

from pathlib import Path

import guide
import pytest

from matcap.cli.main import main

QUICKEST = ("batch.md", "relight.md", "view.md")


@pytest.mark.parametrize("page", QUICKEST)
def test_the_lines_of_a_page_run_and_leave_what_they_name(page: str, tmp_path: Path) -> None:
    faults = [f"{line}: {wrong}" for line, wrong in guide.run(page, tmp_path) if wrong]
    assert not faults


@pytest.mark.parametrize("page", guide.pages())
def test_options_of_all_lines_exist(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    for line in guide.lines_of(page):
        words = guide.words_of(line)
        assert main([words[0], "--help"]) == 0
        result = capsys.readouterr().out
        for option in (word for word in words if word.startswith("--")):
            assert option in result, line


def test_no_line_is_left_out_without_a_reason() -> None:
    left_out = {start.split()[0] for start in guide.LEFT_OUT}
    assert left_out <= {"matcap", "pip", "python"}
    assert len(guide.pages()) >= 8
