"""Threads on one core each, beside a process that uses more."""

import pytest
import torch

from matcap.field.single import single_threaded

pytestmark = pytest.mark.usefixtures("two_threads")


def threads_after_an_operator() -> int:
    torch.rand(1 << 16) * 2
    return torch.get_num_threads()


@pytest.mark.parametrize("workers", [1, 2])
def test_every_thread_computes_on_one_core_and_the_caller_on_its_own_number(workers):
    with single_threaded(workers) as pool:
        found = [pool.submit(threads_after_an_operator) for _ in range(8)]
        assert {one.result() for one in found} == {1}
        assert threads_after_an_operator() == 2
    assert threads_after_an_operator() == 2
