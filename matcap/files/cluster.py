"""Access to a dask.distributed cluster (extra `cluster`); no other module imports Dask.

Submitted functions are pure: those of a lost worker are repeated by another, with the same bits if
all machines are of one kind and run the same build.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from matcap.errors import MatcapError

_PATIENCE = 10  # seconds for the scheduler to answer
_WORKERS_WITHIN = 60  # seconds for a first worker to come


class Cluster:
    """The workers of a scheduler; a context manager.

    Args:
        scheduler: address, such as tcp://host:8786.
        worker: command that starts a worker, for error messages.

    Raises:
        MatcapError: Dask is not installed, the scheduler does not answer, or it has no worker.
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
            raise MatcapError.at(
                scheduler,
                "no dask scheduler answers there",
                f"start one with `dask scheduler`, and workers with `{worker}`",
            ) from error
        try:
            client.wait_for_workers(1, timeout=_WORKERS_WITHIN)
        except TimeoutError as error:
            client.close()
            raise MatcapError.at(
                scheduler, "the dask scheduler has no workers", f"start some with `{worker}`"
            ) from error
        self._client = client

    @property
    def threads(self) -> int:
        """Number of threads of all workers."""
        return max(1, sum(self._client.nthreads().values()))

    def shared(self, value: object) -> object:
        """Send a value to every worker; return a handle to pass to submit()."""
        return self._client.scatter(value, broadcast=True, hash=False)

    def submit(self, function: Callable[..., Any], *arguments: object) -> RemoteResult:
        """Call a module-level function on a worker."""
        return RemoteResult(self._client.submit(function, *arguments, pure=False))

    def close(self) -> None:
        """Disconnect from the scheduler."""
        self._client.close()

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class RemoteResult:
    """Future of a function that was submitted to a cluster."""

    def __init__(self, future: Any) -> None:  # noqa: ANN401
        self._future = future

    def done(self) -> bool:
        """Whether it has finished or failed."""
        return bool(self._future.done())

    def result(self) -> Any:  # noqa: ANN401
        """Wait for the value.

        Raises:
            MatcapError: raised by the function.
            WorkerLost: the cluster failed.
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
        """Cancel it, even if it has started."""
        self._future.cancel(force=True)


class WorkerLost(MatcapError):
    """A worker died; finished work is kept, and the run can be resumed."""
