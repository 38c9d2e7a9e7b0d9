"""The command line as a process: fast to start, honest exit codes, nothing but sentences."""

import random
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import signals

import matcap as package
from matcap.cli import main as main_module
from matcap.errors import MatcapError, UsageError

HEAVY = ("torch", "cv2", "rawpy", "OpenEXR", "OpenImageIO", "safetensors", "tifffile", "numpy")


COMMAND = "from matcap.cli.main import run; run()"


def run(*arguments: str, code: str = COMMAND) -> subprocess.CompletedProcess[str]:
    """The installed command, or other code, in its own process."""
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_help_answers_at_once():
    """By the processor's clock, over that of importing NumPy: machines are not equally fast."""

    def seconds(code: str, *arguments: str) -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        assert run(*arguments, code=code).returncode == 0
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime

    pairs = [(seconds(COMMAND, "--help"), seconds("import numpy")) for _ in range(3)]
    shortest, unit = (min(times) for times in zip(*pairs, strict=True))
    assert shortest < 3.0 * unit


@pytest.mark.parametrize("module", ["matcap", "matcap.cli.main"])
def test_nothing_heavy_is_imported(module):
    code = f"import sys, {module}; print(*[m for m in {HEAVY} if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.split() == []


def test_the_console_script_is_installed():
    script = Path(sys.executable).with_name("matcap")
    found = subprocess.run([script, "--version"], capture_output=True, text=True, check=True)
    assert found.stdout == f"matcap {package.__version__}\n"


@pytest.mark.parametrize("command", [[], ["capture"], ["synth"], ["relight"]])
def test_every_command_explains_itself(matcap, command):
    said = matcap(*command, "--help")
    assert said.code == 0
    assert "Usage: matcap" in said.out


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
def test_wrong_usage_is_2(matcap, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    said = matcap(*arguments)
    assert said.code == 2
    assert said.out == ""
    assert said.err
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def failing(monkeypatch):
    """Makes the command line fail in a given way."""

    def install(failure: BaseException) -> None:
        def fail(*args, **kwargs):
            raise failure

        monkeypatch.setattr(main_module, "app", fail)

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
def test_failures_are_sentences_and_codes(matcap, failing, monkeypatch, failure, code, said):
    monkeypatch.delenv("MATCAP_DEBUG", raising=False)
    failing(failure)
    found = matcap("doctor")
    assert found.code == code
    assert said in found.err
    assert found.err.count("\n") <= 1


@pytest.mark.parametrize("way", ["option", "environment"])
def test_tracebacks_on_request(failing, monkeypatch, capsys, way):
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
