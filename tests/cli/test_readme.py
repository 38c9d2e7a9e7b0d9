"""What the README tells people to type exists and means what it says."""

import re
import shlex
from pathlib import Path

import matcap as package

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
SHELL = [
    line
    for block in re.findall(r"```sh\n(.*?)```", README, re.DOTALL)
    for line in block.split("\n")
]


def test_the_two_first_lines_are_one_line_each():
    main_job, tests = (line for line in SHELL if line.startswith("python3 -m venv"))
    photo = re.search(r"matcap capture (\S+)", main_job)[1]
    assert (ROOT / photo).is_file()
    assert ".venv/bin/pytest" in tests


def test_ci_runs_exactly_the_test_line():
    (line,) = (line for line in SHELL if ".venv/bin/pytest" in line)
    assert line in (ROOT / ".ci" / "run").read_text().splitlines()


def test_python_names_exist():
    names = set(re.findall(r"\bmatcap\.([A-Za-z_]+)", README)) - {"git"}
    assert names <= set(package.__all__)


def test_pictures_exist():
    for picture in re.findall(r"!\[[^]]*\]\(([^)]+)\)", README):
        assert (ROOT / picture).is_file()


# What makes a line quick; the last of an option's values counts.
QUICK = {
    "capture": ("--preset", "instant", "--detail", "160", "--size", "64"),
    "batch": ("--preset", "instant", "--detail", "160", "--size", "64", "-j", "1"),
    "synth": ("--size", "512x64"),
    "relight": ("--size", "64x48"),
    "export": ("--size", "64"),
}


def test_every_line_runs_in_its_order(matcap, tmp_path, monkeypatch):
    """As written, but quickly; pages are only written, for nobody closes the others."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    lines = [line.partition("matcap ")[2] for line in SHELL if re.search(r"(^|/bin/)matcap ", line)]
    lines = [line for line in lines if not line.startswith("view") or "--html" in line]
    assert lines[0].startswith("capture examples/photos/leather.dng")
    for line in lines:
        words = shlex.split(line)
        said = matcap(*words, *QUICK.get(words[0], ()))
        assert said.code == 0, (line, said.err)
    assert "Verdict" in (tmp_path / "materials" / "index.html").read_text()


def test_the_environment_is_activated_before_it_is_used():
    used = next(index for index, line in enumerate(SHELL) if line.startswith("matcap "))
    assert ". .venv/bin/activate" in SHELL[:used]
