"""`matcap doctor`: what it finds, and that it finds what is wrong."""

import json
from importlib.metadata import PackageNotFoundError, version

import pytest

from matcap.errors import MatcapError
from matcap.space.prior import store


def test_a_sound_installation(matcap):
    said = matcap("doctor", "--json")
    report = json.loads(said.out)
    assert report["self_test"]["fault"] is None and report["compiled"]
    assert (said.code, said.err, report["healthy"]) == (0, "", True)
    assert {"torch", "numpy", "typer"} <= set(report["packages"])
    assert report["devices"][0] == "cpu"


@pytest.fixture
def without(monkeypatch):
    """Make a package one that is not installed."""

    def hide(hidden):
        def found(name):
            if name == hidden:
                raise PackageNotFoundError(name)
            return version(name)

        monkeypatch.setattr("matcap.cli.doctor.version", found)

    return hide


def test_the_text_names_the_command_that_installs_a_missing_extra(matcap, without):
    without("pillow-heif")
    said = matcap("doctor", "--no-self-test")
    assert said.code == 0  # extras are no need
    assert 'not installed: pip install "matcap[heic]"' in said.out
    assert "All is well." in said.out


def test_a_missing_need_is_a_fault(matcap, without):
    without("rawpy")
    said = matcap("doctor")
    assert said.code == 3
    assert "rawpy" in said.out
    assert "MISSING" in said.out


@pytest.mark.parametrize("fault", [MatcapError("the prior is damaged"), RuntimeError("no memory")])
def test_a_fault_of_the_self_test_is_reported(matcap, monkeypatch, fault):
    def broken(path=None):
        raise fault

    monkeypatch.setattr(store, "load_prior", broken)
    said = matcap("doctor", "--json")
    report = json.loads(said.out)
    assert (said.code, report["healthy"]) == (3, False)
    assert str(fault) in report["self_test"]["fault"]
