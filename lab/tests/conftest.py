"""Settings of all tests of the laboratory, which use helpers of the product's tests."""

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "tests"))  # arrays, loop_calls, materials, random_maps, small, uniform

settings.register_profile("matcap", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("matcap")


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    """Tests compute little at a time: threads wait for each other, and for what else runs."""
    yield from _threads(1)


@pytest.fixture
def two_threads():
    """For tests of what threads do."""
    yield from _threads(2)


def _threads(count):
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(count)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def lab(capsys):
    """Run a command of matcap-lab in this process; gives code, out and err."""
    from matcap_lab.cli.main import main

    def run(*arguments) -> SimpleNamespace:
        code = main([str(argument) for argument in arguments])
        said = capsys.readouterr()
        assert "Traceback" not in said.err
        return SimpleNamespace(code=code, out=said.out, err=said.err)

    return run
