"""Free memory, checked before work begins, and memory that is kept for the next buffer."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path
from typing import Any

from matcap.errors import MatcapError

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8  # malloc.h


def free_bytes() -> int:
    """Memory that new processes may take: of the machine, or of the control group if less."""
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
    """Fail now rather than after minutes of work.

    Args:
        need: bytes that the work takes at least.
        where: the option that makes it so many.
        remedy: what to do.

    Raises:
        MatcapError: there are fewer.
    """
    free = free_bytes()
    if need > free:
        raise MatcapError(
            f"this takes {need / 1e9:.3g} GB of memory, and {free / 1e9:.3g} GB are free",
            where=where,
            remedy=remedy,
        )


def keep_memory() -> None:
    """Tell glibc to reuse large buffers rather than to fetch them fresh from the system.

    For a process of its own: it holds for all of it, and for threads that are yet to come.
    Elsewhere than on glibc nothing happens.
    """
    library: Any = ctypes.CDLL(None)
    if hasattr(library, "mallopt"):
        library.mallopt(_M_MMAP_THRESHOLD, 1 << 30)
        library.mallopt(_M_TRIM_THRESHOLD, 1 << 30)
        # A thread's own heap holds 64 MB at most: larger buffers would be fetched fresh again.
        library.mallopt(_M_ARENA_MAX, 1)
