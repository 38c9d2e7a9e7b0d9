"""Seconds that each effect takes, all threads together."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from time import perf_counter


class Clock:
    """Adds up what is spent under each name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._lock = Lock()

    @contextmanager
    def on(self, name: str) -> Iterator[None]:
        """Count the time inside the block for `name`."""
        start = perf_counter()
        yield
        spent = perf_counter() - start
        with self._lock:
            self.seconds[name] += spent
