"""Signals: alike, postponed where work must be whole, and no matter to children."""

import os
import signal
import subprocess
import sys

import pytest

from matcap.files.interrupts import postponed, starting_children

BOTH = [signal.SIGINT, signal.SIGTERM]


@pytest.fixture(autouse=True)
def ctrl_c_is_heard():
    """What starts the tests may ignore it, as xdist's workers do."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("number", BOTH)
def test_a_postponed_signal_is_told_and_handlers_come_back(number):
    before = [signal.getsignal(which) for which in BOTH]
    with postponed() as came:
        assert not came()
        os.kill(os.getpid(), number)
        assert came()
    assert came() and [signal.getsignal(which) for which in BOTH] == before


@pytest.mark.parametrize("number", BOTH)
def test_a_signal_while_children_start_comes_afterwards(number):
    reached = []
    with pytest.raises(KeyboardInterrupt), starting_children():
        os.kill(os.getpid(), number)
        reached.append(True)
    assert reached and signal.pthread_sigmask(signal.SIG_BLOCK, []) == set()


@pytest.mark.parametrize("number", BOTH)
def test_both_end_a_command_by_a_keyboard_interrupt(number):
    program = (
        "import os, sys; from matcap.files.interrupts import raise_on_signals\n"
        "came = raise_on_signals()\n"
        f"try: os.kill(os.getpid(), {int(number)}); input()\n"
        "except KeyboardInterrupt: sys.exit(7 if came() else 8)\n"
    )

    def heed():
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    run = subprocess.run([sys.executable, "-c", program], preexec_fn=heed, check=False)
    assert run.returncode == 7


@pytest.mark.parametrize("number", BOTH)
def test_a_signal_waits_until_torch_is_imported(tmp_path, number):
    """Its C++ aborts at an exception in what it imports."""
    (tmp_path / "torch.py").write_text(
        f"import os, time; os.kill(os.getpid(), {int(number)}); time.sleep(0.2); whole = True\n"
    )
    program = (
        "import sys, time; from matcap.files.interrupts import raise_on_signals\n"
        "raise_on_signals()\n"
        "try: import torch; time.sleep(30)\n"
        "except KeyboardInterrupt: sys.exit(7 if hasattr(sys.modules.get('torch'), 'whole') else 8)"
    )
    path = os.pathsep.join([str(tmp_path), *sys.path])
    run = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | {"PYTHONPATH": path}, check=False
    )
    assert run.returncode == 7
