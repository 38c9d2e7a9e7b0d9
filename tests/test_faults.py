"""The script of deliberate faults: each still has its place in the code, and some are tried."""

import pytest
from fault_list import FAULTS
from faults import ROOT, caught, copied


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_every_fault_has_its_place(fault):
    assert (ROOT / "matcap" / fault.file).read_text().count(fault.right) == 1
    assert all((ROOT / one).exists() for one in fault.tests if one.startswith("tests/"))


def test_a_fault_is_caught(tmp_path):
    copied(tmp_path)
    assert caught(next(one for one in FAULTS if "add up" in one.name), tmp_path)
