"""A dask.distributed cluster (extra `cluster`): one way to come to its workers."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from matcap.errors import MatcapError

_PATIENCE = 10  # seconds for the scheduler to answer
_WORKERS_WITHIN = 60  # seconds for a first worker to come


def connect(scheduler: str, worker: str = "dask worker") -> Any:  # noqa: ANN401
    """A client of a scheduler that has workers; close it, or use it in a `with`.

    Args:
        scheduler: its address, such as tcp://host:8786.
        worker: the command that starts a worker as it is wanted here.

    Raises:
        MatcapError: the extra is missing, nobody answers at the address, or there is no worker.
    """
    try:
        distributed: Any = import_module("distributed")
    except ImportError as error:
        raise MatcapError(
            "clusters need dask.distributed", remedy='run: pip install "matcap[cluster]"'
        ) from error
    try:
        client = distributed.Client(scheduler, timeout=_PATIENCE, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise MatcapError(
            "no dask scheduler answers there",
            where=scheduler,
            remedy=f"start one with `dask scheduler`, and workers with `{worker}`",
        ) from error
    try:
        client.wait_for_workers(1, timeout=_WORKERS_WITHIN)
    except TimeoutError as error:
        client.close()
        raise MatcapError(
            "the dask scheduler has no workers",
            where=scheduler,
            remedy=f"start some with `{worker}`",
        ) from error
    return client
