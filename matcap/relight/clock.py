"""Seconds spent by effect, summed over threads."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from time import perf_counter


class Clock:
    """Adds up wall-clock seconds by name; threads may share one."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._lock = Lock()

    @contextmanager
    def on(self, name: str) -> Iterator[None]:
        """Add the time spent inside the `with` block to `name`."""
        start = perf_counter()
        yield
        spent = perf_counter() - start
        with self._lock:
            self.seconds[name] += spent
