"""Threads on one core each, beside a process that uses more."""

from contextlib import suppress

import pytest
import torch

from matcap.field.source import one_thread, single_threaded

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


def test_one_thread_is_for_its_context_alone_and_restores_the_number_after_an_error():
    with suppress(ValueError), one_thread():
        assert torch.get_num_threads() == 1
        raise ValueError
    assert torch.get_num_threads() == 2
