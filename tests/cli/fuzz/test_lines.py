"""Command lines out of nothing; lines.py does it by the ten thousand."""

from lines import run


def test_no_command_line_is_more_than_an_answer(tmp_path):
    tally, faults = run(tmp_path, count=40, seed=3)
    assert not faults, "\n".join(faults)
    assert tally["good"] > 3 and tally["refused"] > 20
