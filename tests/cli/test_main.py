"""The command line's start, habits and exit codes."""

import os
import random
import re
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from statistics import median

import pytest
import signals
import typer.main
from materials import a_material

import matcap as package
from matcap.cli import main as main_module
from matcap.cli.main import command_line
from matcap.errors import MatcapError, UsageError
from matcap.files import settings as values

# The command line as a process: fast to start, honest exit codes, nothing but sentences.

HEAVY = ("torch", "cv2", "rawpy", "OpenEXR", "OpenImageIO", "safetensors", "tifffile", "numpy")
COMMAND = "from matcap.cli.main import run; run()"


def run(*arguments: str, code: str = COMMAND, **environment: str):
    """The installed command, or other code, in its own process."""
    command, place = [sys.executable, "-c", code, *arguments], os.environ | environment
    return subprocess.run(command, env=place, capture_output=True, text=True, check=False)


def test_help_takes_at_most_three_times_the_import_of_numpy():
    """By the processor's clock, over that of importing NumPy: machines are not equally fast."""

    def seconds(code: str, *arguments: str) -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        assert run(*arguments, code=code).returncode == 0
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime

    # Other programs slow down both of a pair.
    assert median(seconds(COMMAND, "--help") / seconds("import numpy") for _ in range(5)) < 3.0


@pytest.mark.parametrize(
    ("work", "needed"),
    [
        ("import matcap", ""),
        ("from matcap.cli.main import command_line; command_line()", ""),
        ("import matcap.batch.run", "cv2 safetensors numpy"),
    ],
)
def test_nothing_heavy_is_imported(work, needed):
    code = f"import sys; {work}; print(*[m for m in {HEAVY} if m in sys.modules])"
    found = run(code=code)
    assert (found.returncode, found.stdout.strip()) == (0, needed)


def test_a_command_loads_no_module_of_another():
    shown = "print({'matcap.cli.capture', 'matcap.cli.relight'} & {*sys.modules})"
    found = run(
        "synth", "no.matcap", code=f"import sys; from matcap.cli.main import main; main(); {shown}"
    )
    assert found.stdout == "set()\n"


def test_the_console_script_is_installed():
    script = Path(sys.executable).with_name("matcap")
    found = subprocess.run([script, "--version"], capture_output=True, text=True, check=True)
    assert found.stdout == f"matcap {package.__version__}\n"


@pytest.mark.parametrize("command", ["capture", "batch", "inspect", "synth", "relight", "export"])
def test_help_is_of_everyday_options_and_names_the_others(matcap, command):
    lines = matcap(command, "--help").out.splitlines()
    assert len(lines) < 40 and any("─ Everyday ─" in line for line in lines)
    whole = matcap(command, "--help-all").out
    named = " ".join(lines[next(i for i, line in enumerate(lines) if "By --help-all" in line) :])
    others = re.findall(r"(?<=\s)--?[a-z-]+(?=[,;.])", named)
    assert others and all(f" {option} " in whole for option in others)


def test_help_all_is_of_all_options_everyday_ones_first(matcap):
    lines = matcap("capture", "--help-all").out.splitlines()
    everyday, following = (
        next(i for i, line in enumerate(lines) if f"─ {name} ─" in line)
        for name in ("Everyday", "Several photographs")
    )
    assert everyday < following < 40 and len(lines) < 150
    assert any("--out" in line for line in lines[everyday:following])
    assert any("--roughness" in line for line in lines[following:])
    assert not any("<=" in line for line in lines)


@pytest.mark.parametrize(
    "arguments",
    [
        ["caputre", "a.dng"],
        ["capture"],
        ["capture", "a.dng", "--stpes", "3"],
        ["capture", "a.dng", "--steps", "many"],
        ["capture", "a.dng", "--steps", "-1"],
        ["capture", "a.dng", "--time", "0"],
        ["capture", "a.dng", "--fov", "180"],
        ["capture", "a.dng", "--detail", "1"],
        ["capture", "a.dng", "--normal", "up"],
        ["capture", "a.dng", "--size", "0x5"],
        ["synth", "a.matcap", "--size", "-1x5"],
        ["synth", "a.matcap", "--region", "0,0,8"],
        ["synth", "a.matcap", "--seed", "one"],
        ["relight", ".", "-o", "a.gif"],
    ],
)
def test_wrong_usage_exits_with_2(matcap, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    said = matcap(*arguments)
    assert said.code == 2 and said.out == "" and said.err and list(tmp_path.iterdir()) == []


@pytest.fixture
def failing(monkeypatch):
    """Makes the command line fail in a given way."""

    def install(failure: BaseException) -> None:
        def fail(*args, **kwargs):
            raise failure

        monkeypatch.setattr(main_module, "command_line", fail)

    return install


@pytest.mark.parametrize(
    ("failure", "code", "said"),
    [
        (MatcapError("it broke", where="a.dng", remedy="mend it"), 3, "a.dng: it broke; mend it."),
        (UsageError("no such light", where="--light"), 2, "--light: no such light."),
        (KeyboardInterrupt(), 130, ""),
        (RuntimeError("oh"), 1, "internal error (RuntimeError: oh); please report it"),
    ],
)
def test_failures_are_one_sentence_with_the_right_exit_code(
    matcap, failing, monkeypatch, failure, code, said
):
    monkeypatch.delenv("MATCAP_DEBUG", raising=False)
    failing(failure)
    found = matcap("doctor")
    assert found.code == code and said in found.err and found.err.count("\n") <= 1


@pytest.mark.parametrize("way", ["option", "environment"])
def test_tracebacks_are_shown_on_request(failing, monkeypatch, capsys, way):
    monkeypatch.setenv("MATCAP_DEBUG", "1" if way == "environment" else "0")
    failing(RuntimeError("oh"))
    assert main_module.main(["--debug", "doctor"] if way == "option" else ["doctor"]) == 1
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "number", "between"),
    [
        ("capture", signal.SIGTERM, (2.0, 12.0)),
        ("synth", signal.SIGTERM, (0.5, 5.0)),
        ("synth", signal.SIGINT, (0.5, 5.0)),
        ("batch", signal.SIGTERM, (1.0, 8.0)),
        ("relight", signal.SIGTERM, (0.5, 5.0)),
        ("export", signal.SIGINT, (0.5, 5.0)),
        ("view", signal.SIGTERM, (0.5, 4.0)),
    ],
)
def test_a_signal_leaves_nothing_torn_and_no_traceback(tmp_path, command, number, between):
    signals.prepare(tmp_path)
    struck = signals.strike(command, tmp_path, number, random.uniform(*between))
    assert signals.faults(command, tmp_path, struck) == [], struck.said


# What every command has in common: help, colour, completion, quiet and verbose.


def leaves(command, words=()):
    """(words, command) of every command that does something."""
    inner = getattr(command, "commands", None)
    if inner is None:
        yield words, command
        return
    for name, one in inner.items():
        yield from leaves(one, (*words, name))


LEAVES = dict(leaves(typer.main.get_command(command_line())))
# What only looks prints its results in any case.
TALKING = {"doctor", "inspect"}


@pytest.mark.parametrize("words", LEAVES, ids=" ".join)
def test_every_command_and_option_has_help(words):
    command = LEAVES[words]
    assert command.help
    for parameter in command.params:
        if parameter.name != "help":
            assert getattr(parameter, "help", None), (words, parameter.name)


@pytest.mark.parametrize("words", [one for one in LEAVES if one[0] not in TALKING], ids=" ".join)
def test_every_command_that_writes_has_quiet(words):
    options = {option for parameter in LEAVES[words].params for option in parameter.opts}
    assert {"-q", "--quiet"} <= options


@pytest.mark.parametrize(
    "environment", [{"NO_COLOR": "1", "FORCE_COLOR": "1"}, {"TERM": "dumb"}], ids=str
)
def test_no_color_is_respected(environment):
    said = run("export", "--help", **environment)
    assert said.returncode == 0 and "\x1b[3" not in said.stdout and "\x1b[1;3" not in said.stdout


def test_dumb_terminals_get_plain_lines(matcap, pipeline, photo, tmp_path, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich takes it for a terminal
    monkeypatch.setenv("TERM", "dumb")
    said = matcap("capture", photo, "-o", tmp_path / "out", "--size", "16")
    assert said.code == 0 and "preparing the texture" in said.err and "\x1b" not in said.err


@pytest.mark.parametrize(
    ("typed", "offered"), [("matcap ex", "export"), ("matcap export --wor", "--workflow")]
)
def test_the_shell_completes(typed, offered):
    last = str(len(typed.split()) - 1)
    said = run(_MATCAP_COMPLETE="complete_bash", COMP_WORDS=typed, COMP_CWORD=last)
    assert offered in said.stdout.split()


def test_verbose_adds_the_cost_alone(matcap):
    quiet, verbose = matcap("doctor", "--no-self-test"), matcap("-v", "doctor", "--no-self-test")
    assert verbose.out == quiet.out and quiet.err == "" and verbose.err.startswith("matcap ")
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
    assert (ROOT / photo).is_file() and ".venv/bin/pytest" in tests


def test_ci_runs_exactly_the_test_line():
    (line,) = (line for line in SHELL if ".venv/bin/pytest" in line)
    assert line in (ROOT / ".ci" / "run").read_text().splitlines()


def test_python_names_exist():
    names = set(re.findall(r"\bmatcap\.([A-Za-z_]+)", README)) - {"git"}
    assert names <= set(package.__all__)


def test_the_environment_is_activated_before_it_is_used():
    used = next(index for index, line in enumerate(SHELL) if line.startswith("matcap "))
    assert ". .venv/bin/activate" in SHELL[:used]


# Every number of the command line is finite and in range before any work; counts are bounded.


@pytest.fixture
def place(tmp_path, monkeypatch):
    """The current folder, with a folder of one material."""
    (tmp_path / "a").mkdir()
    a_material("a").save(tmp_path / "a" / "a.matcap")
    monkeypatch.chdir(tmp_path)
    return tmp_path


HUGE = "9" * 23


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("blend", "a/a.matcap", "a/a.matcap", "-t", "0:1:99999999"), "more than 256 steps"),
        (("blend", "a/a.matcap", "a/a.matcap", "-t", f"0:1:{HUGE}"), "neither a share"),
        (("blend", "a/a.matcap", "a/a.matcap", "--seed", HUGE), "is out of range"),
        (("synth", "a", "--seed", HUGE), "is out of range"),
        (("synth", "a", "--seed", "1e3"), "is not a whole number"),
        (("relight", "a", "--seed", HUGE), "is out of range"),
        (("view", "a", "--seed", HUGE), "is out of range"),
        (("sample", "--seed", HUGE), "is out of range"),
        (("sample", "--seed", str(2**63 - 1), "-n", "2"), "is out of range"),
        (("export", "a", "--to", "usd", "--seed", HUGE), "is out of range"),
        (("relight", "a", "--light", "1e300,0,1"), "is out of range"),
        (("relight", "a", "--light", "0,0,1e-300"), "is out of range"),
        (("relight", "a", "--light", "0,0,1,1e300"), "is out of range"),
        (("relight", "a", "--light", "nan,0,1"), "is not a light"),
        (("relight", "a", "--tolerance", "inf"), "give between 0 and 1"),
        (("relight", "a", "--tolerance", "nan"), "give between 0 and 1"),
        (("relight", "a", "--tolerance", "-1"), "give between 0 and 1"),
        (("relight", "a", "--size", "99999999"), "a side of more than 32768"),
        (("relight", "a", "--size", "32768"), "GB"),
        (("export", "a", "--to", "usd", "--size", "65536"), "GB"),
        (("synth", "a", "--size", "1000000000", "-j", "1"), "are needed but the disk has"),
        (("synth", "a", "--scheduler", "nonsense"), "'nonsense' is not an address"),
        (("view", "a", "--html", "a.html", "--tile", "99999999"), "2048"),
        (("inspect", "a", "--fov", "nan"), "give between 1 and 170"),
        (("inspect", "a.matcap", "--together"), "--together: there are no photographs"),
        (("capture", "a.jpg", "--together"), "--together: there is one photograph"),
        (("capture", "a.jpg", "--no-drawing"), "--no-drawing: only a decoder uses this"),
    ],
)
def test_numbers_out_of_range_are_refused_before_any_work(matcap, place, words, said):
    before, began = sorted(place.rglob("*")), time.monotonic()
    found = matcap(*words)
    assert found.code in (2, 3) and said in " ".join(found.err.replace("│", " ").split())
    assert sorted(place.rglob("*")) == before and time.monotonic() - began < 20.0


def test_options_are_checked_before_existing_folders(matcap, place):
    assert matcap("synth", "a", "--size", "16", "-j", "1", "-o", "more", "-q").code == 0
    for wrong in (
        ("--scheduler", "nonsense"), ("--adjust", "relief=x"), ("--udim", "11x1"),
        ("--tile", "x", "--region", "0,0,17,16"), ("--mask", "none.png"), ("--export", "unrael"),
    ):  # fmt: skip
        said = matcap("synth", "a", "--seed", "2", "-o", "more", "-j", "1", *wrong)
        assert said.code == 2 and "exists" not in said.err, wrong


def test_synth_takes_the_folder_that_others_take(matcap, place):
    words = ("--size", "16", "-j", "1", "-q")
    assert matcap("synth", "a", *words).code == 0 and (place / "a_16x16_seed0" / "a.json").is_file()
    (place / "empty").mkdir()
    said = matcap("synth", "empty", *words)
    assert said.code == 3 and "no map set and no material in this folder" in said.err
    said = matcap("synth", "a_16x16_seed0", *words)
    assert said.code == 3 and "this is a map set, from which no more can be synthesised" in said.err


def test_several_lights_add_up(matcap, place):
    import numpy as np

    from matcap.files.exr import read_exr

    assert matcap("synth", "a", "--size", "64", "-j", "1", "-o", "set", "-q").code == 0
    for name, lights in {"both": ("left", "top"), "left": ("left",), "top": ("top",)}.items():
        words = [word for light in lights for word in ("--light", light)]
        more = ("--effects", "all", "--size", "32", "-o", f"{name}.exr")
        said = matcap("relight", "set", *words, *more)
        assert said.code == 0, said.err
    both, left, top = (read_exr(place / f"{name}.exr").pixels for name in ("both", "left", "top"))
    off = np.abs(both - left - top).mean()  # each light by itself has parallax and shadows
    assert off < 0.02 * both.mean()


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "1e400", "x", ""])
def test_nan_is_no_number(matcap, text):
    assert matcap("sample", "-t", text).code == 2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--width-cm", "20mm"), "'20mm' is not a number between 0.01 and 100000"),
        (("--albedo", "0,18"), "'0,18' is not a number between 0.005 and 1"),
        (("--steps", "1.5"), "'1.5' is not a whole number between 0 and 10000000"),
        (("--crop", "1,2"), "'1,2' is not a rectangle such as 100,0,512,512"),
    ],
)
def test_what_is_no_number_is_repeated_with_what_is_one(matcap, words, said):
    found = matcap("capture", "a.dng", *words)
    assert found.code == 2 and said in " ".join(found.err.replace("│", " ").split())


@pytest.mark.parametrize("seed", [-(2**63), 2**63 - 1, 0])
def test_seeds_of_64_bits_are_seeds(seed):
    assert values.seed(str(seed)) == seed
