"""What every command has in common: help, colour, completion, quiet and verbose."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer.main

import matcap as package
from matcap.cli.main import app

START = "from matcap.cli.main import run; run()"


def leaves(command, words=()):
    """(words, command) of every command that does something."""
    inner = getattr(command, "commands", None)
    if inner is None:
        yield words, command
        return
    for name, one in inner.items():
        yield from leaves(one, (*words, name))


LEAVES = dict(leaves(typer.main.get_command(app)))
# What only looks prints its results in any case.
TALKING = {"doctor", "inspect"}


def run(*arguments, **environment):
    place = os.environ | environment
    command = [sys.executable, "-c", START, *arguments]
    return subprocess.run(command, env=place, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("words", LEAVES, ids=" ".join)
def test_every_command_and_option_has_help(words):
    command = LEAVES[words]
    assert command.help
    for parameter in command.params:
        if parameter.name != "help":
            assert getattr(parameter, "help", None), (words, parameter.name)


@pytest.mark.parametrize(
    "words",
    [words for words in LEAVES if words[0] not in TALKING],
    ids=" ".join,
)
def test_commands_that_write_can_be_quiet(words):
    options = {option for parameter in LEAVES[words].params for option in parameter.opts}
    assert {"-q", "--quiet"} <= options


@pytest.mark.parametrize(
    "environment", [{"NO_COLOR": "1", "FORCE_COLOR": "1"}, {"TERM": "dumb"}], ids=str
)
def test_no_colour_where_none_is_wanted(environment):
    said = run("export", "--help", **environment)
    assert said.returncode == 0
    assert "\x1b[3" not in said.stdout
    assert "\x1b[1;3" not in said.stdout


def test_dumb_terminals_get_plain_lines(matcap, pipeline, photo, tmp_path, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich takes it for a terminal
    monkeypatch.setenv("TERM", "dumb")
    said = matcap("capture", photo, "-o", tmp_path / "out", "--size", "16")
    assert said.code == 0
    assert "index" in said.err
    assert "\x1b" not in said.err


@pytest.mark.parametrize(
    ("typed", "offered"), [("matcap ex", "export"), ("matcap export --wor", "--workflow")]
)
def test_the_shell_completes(typed, offered):
    said = run(
        _MATCAP_COMPLETE="complete_bash",
        COMP_WORDS=typed,
        COMP_CWORD=str(len(typed.split()) - 1),
    )
    assert offered in said.stdout.split()


def test_verbose_tells_the_cost_and_nothing_else(matcap):
    quiet, verbose = matcap("doctor", "--no-self-test"), matcap("-v", "doctor", "--no-self-test")
    assert verbose.out == quiet.out
    assert quiet.err == ""
    assert verbose.err.startswith("matcap ")
    assert " s" in verbose.err


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
