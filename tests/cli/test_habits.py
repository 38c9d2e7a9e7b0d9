"""What every command has in common: help, colour, completion, quiet and verbose."""

import os
import subprocess
import sys

import pytest
import typer.main

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
# What only measures or trains tells its results in any case.
TALKING = {"bench", "prior", "doctor", "inspect"}


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
    [w for w in LEAVES if w[0] not in TALKING and w != ("inverse", "evaluate")],
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
