"""The process: Ctrl-C, memory, silenced decoders, compiled loops, a Dask cluster."""

from __future__ import annotations

import ctypes
import gc
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, redirect_stderr, suppress
from importlib import import_module
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

from matcap.errors import MatcapError
from matcap.files.names import Progress

Shown = TypeVar("Shown", bound=Progress)

# Handling of Ctrl-C and SIGTERM: both raise KeyboardInterrupt, but not inside atomic steps.

_BOTH = (signal.SIGINT, signal.SIGTERM)


def raise_on_signals() -> Callable[[], bool]:
    """Make both signals raise KeyboardInterrupt in the main thread, for the whole process.

    Returns:
        A function that returns whether a signal has arrived.
    """
    came: list[int] = []

    def raised(number: int, frame: FrameType | None) -> None:
        came.append(number)
        # Their C++ aborts at an exception: again when they are imported.
        if importing("torch") or importing("OpenImageIO"):
            again = threading.Timer(0.05, os.kill, (os.getpid(), number))
            again.daemon = True
            again.start()
        else:
            signal.default_int_handler(number, frame)

    for which in _BOTH:
        if signal.getsignal(which) is not signal.SIG_IGN:  # as under nohup
            signal.signal(which, raised)
    return lambda: bool(came)


def importing(name: str) -> bool:
    """Whether a module's import has begun and not ended."""
    return getattr(getattr(sys.modules.get(name), "__spec__", None), "_initializing", False)


def ignore_signals() -> None:
    """Ignore both signals from now on, in a process that is about to end."""
    for which in _BOTH:
        signal.signal(which, signal.SIG_IGN)


@contextmanager
def postponed() -> Iterator[Callable[[], int]]:
    """Context in which neither signal interrupts, for work that must be complete.

    Yields a function that returns how many signals have arrived, a SIGTERM counting as two Ctrl-C.
    Signals interrupt the main thread only; in other threads the context does nothing.
    """
    came: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield lambda: 0
        return
    before = {which: signal.getsignal(which) for which in _BOTH}
    for which in _BOTH:
        if before[which] is not signal.SIG_IGN:
            signal.signal(which, lambda number, frame: came.append(number))
    try:
        yield lambda: len(came) + came.count(signal.SIGTERM)
    finally:
        for which, handler in before.items():
            signal.signal(which, handler or signal.SIG_DFL)


@contextmanager
def starting_children() -> Iterator[None]:
    """Context for starting processes, which inherit blocked signals until settle_child()."""
    from multiprocessing import resource_tracker

    with postponed() as came:
        resource_tracker.ensure_running()  # its own start unblocks both signals
        signal.pthread_sigmask(signal.SIG_BLOCK, _BOTH)
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, _BOTH)
    for _ in range(came()):
        signal.raise_signal(signal.SIGINT)


def settle_child() -> None:
    """Set up a worker process: ignore Ctrl-C, which the main process handles.

    It ends silently at SIGTERM, which process pools send, and with its parent, however that ends.
    """
    from multiprocessing import parent_process

    def follow() -> None:
        parent = parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _BOTH)


# Suppresses the messages that decoders print to the terminal.
#
# LibRaw and libpng print errors to file descriptor 2, tifffile and exifread log them; the same
# errors are raised as exceptions. Output of this process to sys.stderr, such as progress, is not
# suppressed.

_CHATTY = ("tifffile", "exifread")


class _Silence:
    """Redirection of descriptor 2, shared by all threads: begun by the first, ended by the last.

    If each thread saved and restored it, an overlap could leave it redirected.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0
        self._undo = ExitStack()

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Context of one thread."""
        with self._lock:
            self._inside += 1
            if self._inside == 1:
                self._begin(self._undo)
        try:
            yield
        finally:
            with self._lock:
                self._inside -= 1
                if self._inside == 0:
                    self._undo.close()

    @staticmethod
    def _begin(undo: ExitStack) -> None:
        for name in _CHATTY:
            logger, handler = logging.getLogger(name), logging.NullHandler()
            logger.addHandler(handler)  # without any, warnings are printed
            undo.callback(logger.removeHandler, handler)
        try:
            kept = os.dup(2)
        except OSError:  # a process without stderr, such as a service
            return
        undo.callback(os.close, kept)
        undo.callback(os.dup2, kept, 2)
        if _is_descriptor_2(sys.stderr):
            own = undo.enter_context(
                os.fdopen(kept, "w", buffering=1, closefd=False, errors="replace")
            )
            undo.enter_context(redirect_stderr(own))
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 2)
        os.close(nowhere)


def _is_descriptor_2(stream: object) -> bool:
    try:
        return stream.fileno() == 2  # type: ignore[attr-defined]
    except (AttributeError, OSError, ValueError):
        return False


_silence = _Silence()


def quiet_decoders() -> AbstractContextManager[None]:
    """Context in which messages of decoders are suppressed, in all threads."""
    return _silence.kept()


# Cores, checks of free memory, reuse of large buffers by glibc, rarer garbage collection.

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8  # malloc.h
_MOST_RESIDENT = 1_500_000_000  # bytes from which kept memory is returned


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def free_bytes() -> int:
    """Available memory in bytes, of the machine or of the control group, whichever is less."""
    free = []
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                free.append(int(line.split()[1]) * 1024)
        group = Path("/sys/fs/cgroup")
        most = (group / "memory.max").read_text().strip()
        if most != "max":
            free.append(int(most) - int((group / "memory.current").read_text()))
    except (OSError, ValueError, IndexError):
        pass
    if not free:
        free.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2)
    return max(0, min(free))


def check_memory(need: int, where: str, remedy: str) -> None:
    """Check that memory suffices before work begins.

    Args:
        need: bytes that the work takes at least.
        where: the option that the error names.

    Raises:
        MatcapError: less memory is free.
    """
    free = free_bytes()
    if need > free:
        raise MatcapError.at(
            where,
            f"this takes {need / 1e9:.3g} GB of memory, and {free / 1e9:.3g} GB are free",
            remedy,
        )


def keep_memory() -> None:
    """Make glibc reuse large buffers instead of returning them to the system.

    Affects the whole process, and threads that are started later. No-op without glibc. Cycles of
    objects are collected less often: importing PyTorch makes 300,000 objects and no garbage, and a
    capture leaves 1500 in cycles, no tensor among them.

    PyTorch, if imported later, aligns large tensors to huge pages: what is left free between two of
    them makes room for the next of their size, which glibc cannot place where one of 64-byte
    alignment was freed. A capture needs 0.14 GB less.
    """
    gc.set_threshold(500_000)
    os.environ.setdefault("THP_MEM_ALLOC_ENABLE", "1")
    library: Any = ctypes.CDLL(None)
    if hasattr(library, "mallopt"):
        library.mallopt(_M_MMAP_THRESHOLD, 1 << 30)
        library.mallopt(_M_TRIM_THRESHOLD, 1 << 30)
        # Heaps of single threads are limited to 64 MB, so that they would not keep larger buffers.
        library.mallopt(_M_ARENA_MAX, 1)


def return_memory() -> None:
    """Return what keep_memory() kept to the system, if the process holds more than _MOST_RESIDENT.

    Kept buffers are cut to pieces by those in use, and no later work can use them all. It takes as
    long as clearing the pages again: 0.2 s for 300 MB. No-op but with glibc, on Linux.
    """
    library: Any = ctypes.CDLL(None)
    with suppress(OSError):
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        if hasattr(library, "malloc_trim") and pages * os.sysconf("SC_PAGE_SIZE") > _MOST_RESIDENT:
            library.malloc_trim(0)


def returning_memory(on_progress: Callable[[Shown], None]) -> Callable[[Shown], None]:
    """A callback for progress that calls return_memory() where a stage begins: each has buffers of
    other sizes. For processes that are matcap's own.
    """
    stages: set[str] = set()

    def report(now: Shown) -> None:
        if now.stage not in stages:
            stages.add(now.stage)
            return_memory()
        on_progress(now)

    return report


# Loads compiled loops from the folders of their sources.


def find_library(folder: Path, form: tuple[str, int]) -> Any | None:  # noqa: ANN401
    """Load the library of a folder; None if it is missing or of another interface version.

    Args:
        folder: with kernel.c and the library built from it.
        form: name of the function that returns the interface version, and the expected version.
    """
    name, expected = form
    for suffix in EXTENSION_SUFFIXES:
        path = folder / f"kernel{suffix}"
        if path.is_file():
            try:
                library = ctypes.CDLL(str(path))
                if getattr(library, name)() == expected:
                    return library
            except (OSError, AttributeError):
                continue
    return None


def not_built(what: str) -> MatcapError:
    """The error for a missing library."""
    return MatcapError(
        f"the compiled loops of {what} were not built when matcap was installed",
        remedy="install a C compiler (gcc, clang or MSVC) and then matcap again",
    )


# Access to a dask.distributed cluster (extra `cluster`); no other module imports Dask.
#
# Submitted functions are pure: those of a lost worker are repeated by another, with the same bits
# if all machines are of one kind and run the same build.

_PATIENCE = 10  # seconds for the scheduler to answer
_WORKERS_WITHIN = 60  # seconds for a first worker to come


def dask_client(scheduler: str, worker: str = "dask worker") -> Any:  # noqa: ANN401
    """The client of a scheduler that has workers; a context manager.

    Args:
        scheduler: address, such as tcp://host:8786.
        worker: command that starts a worker, for error messages.

    Raises:
        MatcapError: Dask is not installed, the scheduler does not answer, or it has no worker.
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
    return client


def dask_threads(client: Any) -> int:  # noqa: ANN401
    """Number of threads of all workers."""
    return max(1, sum(client.nthreads().values()))


class RemoteResult:
    """Future of a module-level function that is called on a worker of a cluster."""

    def __init__(self, client: Any, function: Callable[..., Any], *arguments: object) -> None:  # noqa: ANN401
        self._future = client.submit(function, *arguments, pure=False)

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
