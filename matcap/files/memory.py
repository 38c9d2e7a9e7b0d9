"""Cores, checks of free memory, reuse of large buffers by glibc, rarer garbage collection."""

from __future__ import annotations

import ctypes
import gc
import os
from pathlib import Path
from typing import Any

from matcap.errors import MatcapError

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8  # malloc.h


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
    objects are collected less often: importing PyTorch makes a million objects and no garbage.
    """
    gc.set_threshold(50_000)
    library: Any = ctypes.CDLL(None)
    if hasattr(library, "mallopt"):
        library.mallopt(_M_MMAP_THRESHOLD, 1 << 30)
        library.mallopt(_M_TRIM_THRESHOLD, 1 << 30)
        # Heaps of single threads are limited to 64 MB, so that they would not keep larger buffers.
        library.mallopt(_M_ARENA_MAX, 1)
