"""Progress display of long renderings."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic

# Seconds before the first output.
_PATIENCE = 2.0


@contextmanager
def shown(*, quiet: bool) -> Iterator[Callable[[float], None]]:
    """A progress callback that prints the share done and the remaining time.

    Only on a terminal, and only after two seconds.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn("relighting"), BarColumn(), TimeRemainingColumn())
    bar = Progress(*columns, console=console, transient=True)
    task = bar.add_task("relighting", total=1.0)
    start, visible = monotonic(), not quiet and console.is_terminal

    def progress(share: float) -> None:
        if visible and monotonic() - start > _PATIENCE:
            bar.start()
            bar.update(task, completed=share)

    try:
        yield progress
    finally:
        if bar.live.is_started:
            bar.stop()
