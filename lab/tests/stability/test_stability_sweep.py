"""`sweep.py` finds what it looks for, counts it and says so by its exit code."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch
from stable import domains, reflectance
from stable.domains import Entry
from stable.edges.swept import Swept, sweep
from stable.reflectance import CASES, reflected
from sweep import main

from matcap.errors import MatcapError


def test_a_formula_that_fails_is_found(monkeypatch):
    def naive(diffuse, specular, roughness, normal, to_light, to_view):
        half = to_light + to_view
        return diffuse / torch.sqrt((half * half).sum(0, keepdim=True)) + 0.0 * (
            specular + roughness + normal[:1]
        )

    monkeypatch.setattr(reflectance, "cook_torrance", naive)
    found = sweep(reflected(CASES["light opposed to view"], 100), 100, seed=0)
    assert (found.draws, found.broken) == (100, 100)


def domain_of(outcome):
    def domain(_):
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    return domain


@pytest.mark.parametrize(
    ("outcome", "broken", "refused", "code"),
    [
        (Swept(1, worst=0.5, where="there"), 0, 0, 0),
        (MatcapError("the light is too bright", remedy="give it less"), 0, 1, 0),
        (MatcapError("something is wrong"), 1, 0, 4),
        (IndexError("out of range"), 1, 0, 4),
        (RuntimeWarning("divide by zero"), 1, 0, 4),
        (Swept(3, 2, 0, 0.5, "there"), 2, 0, 4),
        (Swept(1, slowest=11.0), 0, 0, 0),
    ],
    ids=["sound", "a sentence", "no remedy", "a bug", "a warning", "values", "its own clock"],
)
def test_what_is_found_is_counted_shown_and_answered(
    monkeypatch, capsys, tmp_path, outcome, broken, refused, code
):
    entries = {"a domain": Entry(domain_of(outcome), 1.0, "1")}
    monkeypatch.setattr(domains, "DOMAINS", {"sets": entries})
    assert main(["--quick", "-o", str(tmp_path), "sets=1"]) == code
    said = capsys.readouterr()
    assert f"broken {broken}, refused {refused}" in said.err.replace(".00", "")
    assert "| a domain |" in said.out
    assert ("IndexError: out of range" in said.out) == isinstance(outcome, IndexError)
    again = main(["--quick", "-o", str(tmp_path), "sets=1"])
    assert again == code and not capsys.readouterr().err  # from its CSV


def test_a_call_that_takes_too_long_is_a_failure(monkeypatch, tmp_path):
    monkeypatch.setitem(domains.LONGEST, "sets", -1.0)
    monkeypatch.setattr(domains, "DOMAINS", {"sets": {"slow": Entry(domain_of(Swept(1)), 1.0)}})
    assert main(["-o", str(tmp_path), "sets=1"]) == 4


def test_it_runs_from_any_folder_as_documented(tmp_path):
    command = [sys.executable, str(Path(__file__).with_name("sweep.py")), "--help"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "GROUP=DRAWS" in done.stdout
