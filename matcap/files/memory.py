"""Free memory, checked before work begins."""

from __future__ import annotations

import os
from pathlib import Path

from matcap.errors import MatcapError


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
