"""Mutated files give an error of matcap or a finite picture; fuzz_readers.py runs more of them."""

import pytest
from fuzz_readers import TARGETS, faults


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_mutations_are_refused_or_read(tmp_path, target):
    assert [said for _, said in faults(target, 25, 1, tmp_path)] == []
