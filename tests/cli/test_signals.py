"""A few signals at random moments; `python tests/cli/signals.py 50` sends many."""

import random
import signal

import pytest
import signals


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
