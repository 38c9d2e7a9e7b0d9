"""`matcap-lab`: help, what pages show of it, defaults, and its wheel."""

import re
import shlex
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
import typer.main

from matcap_lab.cli.main import app
from matcap_lab.inverse.train import TrainSettings
from matcap_lab.train.evaluate import EvaluateSettings, VarietySettings

ROOT = Path(__file__).parents[2]
COMMAND = typer.main.get_command(app)


def leaves(command, words=()):
    """(words, command) of every command that does something."""
    inner = getattr(command, "commands", None)
    if inner is None:
        yield words, command
    for name, one in (inner or {}).items():
        yield from leaves(one, (*words, name))


LEAVES = dict(leaves(COMMAND))
SHOWN = {
    line
    for page in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("matcap/**/*.md")]
    for line in re.findall(r"^ *(matcap-lab [a-z].*)$", page.read_text("utf-8"), re.MULTILINE)
}


@pytest.mark.parametrize("words", LEAVES, ids=" ".join)
def test_every_command_and_option_has_help(words):
    assert LEAVES[words].help
    for parameter in LEAVES[words].params:
        assert parameter.name == "help" or getattr(parameter, "help", None), parameter.name


@pytest.mark.parametrize("line", sorted(SHOWN))
def test_every_command_shown_parses(line):
    words = shlex.split(re.sub(r"\[.*?\]|\(.*?\)|\$m", "", line.partition("#")[0]))[1:]
    command, context, name = COMMAND, None, "matcap-lab"
    while hasattr(command, "get_command"):
        context = command.make_context(name, words[:1], parent=context, resilient_parsing=True)
        name, *words = words
        command = command.get_command(context, name)
        assert command is not None, f"there is no {name}"
    options = {option for parameter in command.params for option in parameter.opts}
    assert {word for word in words if word.startswith("--")} <= options


def test_pages_show_commands():
    assert len(SHOWN) > 30


@pytest.mark.parametrize(
    ("words", "settings"),
    [
        (("inverse", "train"), TrainSettings),
        (("prior", "evaluate"), EvaluateSettings),
        (("prior", "variety"), VarietySettings),
    ],
)
def test_options_have_the_defaults_of_the_settings(words, settings):
    """Options are typed by hand, so that --help loads no torch."""
    fields = settings.__dataclass_fields__
    options = {one.name: one.default for one in LEAVES[words].params if one.name in fields}
    assert options
    assert options == {name: fields[name].default for name in options}


def test_help_loads_no_large_library():
    program = "import sys, matcap_lab.cli.main; print({'torch', 'cv2'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.strip() == "set()"


def test_the_wheel_has_code_and_weights(tmp_path):
    pytest.importorskip("setuptools")
    build = "from setuptools import build_meta as b; b.build_wheel(__import__('sys').argv[1])"
    command = [sys.executable, "-c", build, str(tmp_path)]
    ignored = shutil.ignore_patterns("tests", "build", "*.egg-info", "__pycache__")
    source = shutil.copytree(ROOT / "lab", tmp_path / "lab", ignore=ignored)
    subprocess.run(command, cwd=source, capture_output=True, check=True)
    (wheel,) = tmp_path.glob("matcap_lab-*.whl")
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    files = (path for path in (ROOT / "lab" / "matcap_lab").rglob("*") if path.is_file())
    tree = {str(file.relative_to(ROOT / "lab")) for file in files if file.suffix != ".pyc"}
    assert names == tree
