"""A batch that is killed with -9 and started again; kills.py does it two hundred times."""

import sys

import pytest
from kills import torture


@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")
def test_two_kills_leave_nothing_torn_and_the_same_result(tmp_path):
    tally = torture(tmp_path, kills=2, photographs=2, jobs=1, seed=2)
    assert tally.kills == 2 and tally.complete >= 1
