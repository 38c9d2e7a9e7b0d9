"""A dask.distributed cluster (extra `cluster`): the one module that knows of it.

Work that is sent there is a pure function of its arguments: a lost worker's is done again by
another, to the same bits as long as the machines are of one kind and run one build.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from matcap.errors import MatcapError

_PATIENCE = 10  # seconds for the scheduler to answer
_WORKERS_WITHIN = 60  # seconds for a first worker to come


class Cluster:
    """The workers of a scheduler; close it, or use it in a `with`.

    Args:
        scheduler: its address, such as tcp://host:8786.
        worker: the command that starts a worker as it is wanted here.

    Raises:
        MatcapError: the extra is missing, no answer at the address, or there is no worker.
    """

    def __init__(self, scheduler: str, worker: str = "dask worker") -> None:
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
        self._client = client

    @property
    def threads(self) -> int:
        """Of all workers."""
        return max(1, sum(self._client.nthreads().values()))

    def shared(self, value: object) -> object:
        """A value that every worker holds, to be given to what is submitted."""
        return self._client.scatter(value, broadcast=True, hash=False)

    def submit(self, function: Callable[..., Any], *arguments: object) -> RemoteResult:
        """Have a module-level function called."""
        return RemoteResult(self._client.submit(function, *arguments, pure=False))

    def close(self) -> None:
        """Leave the cluster as it was."""
        self._client.close()

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class RemoteResult:
    """What a cluster is asked for."""

    def __init__(self, future: Any) -> None:  # noqa: ANN401
        self._future = future

    def done(self) -> bool:
        """Whether it is there, or never will be."""
        return bool(self._future.done())

    def result(self) -> Any:  # noqa: ANN401
        """The value, when it is there.

        Raises:
            MatcapError: of the function, or a WorkerLost where there is no value for other reasons.
        """
        try:
            return self._future.result()
        except MatcapError:
            raise
        except Exception as error:
            raise WorkerLost(
                f"the cluster could not compute a part ({error})",
                remedy="look at its workers, and go on with --resume",
            ) from error

    def cancel(self) -> None:
        """Forget about it, even where it is begun."""
        self._future.cancel(force=True)


class WorkerLost(MatcapError):
    """A worker died; what the others finished is kept for another try."""
