"""Wall and processor times of calls."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence


def in_turn(calls: Sequence[Callable[[], object]], repeats: int) -> tuple[list[float], list[float]]:
    """Median wall and processor times of each call, s; the calls alternate."""
    wall: list[list[float]] = [[] for _ in calls]
    processor: list[list[float]] = [[] for _ in calls]
    for _ in range(repeats):
        for index, call in enumerate(calls):
            started, worked = time.perf_counter(), time.process_time()
            call()
            wall[index].append(time.perf_counter() - started)
            processor[index].append(time.process_time() - worked)
    return [statistics.median(t) for t in wall], [statistics.median(t) for t in processor]
