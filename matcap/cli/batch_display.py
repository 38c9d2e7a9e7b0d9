"""Progress display of a batch on stderr: live on a terminal, a line per sample elsewhere."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn

from matcap.files.values import spoken_duration

if TYPE_CHECKING:
    from matcap.batch.entries import BatchEntry
    from matcap.files.progress import Progress as WorkProgress

_FIT = ("good", "usable")  # verdicts


class BatchDisplay:
    """Shows the progress of a batch on a console.

    Args:
        console: the console to print on.
        bars: the live display, or None to print lines.
        quiet: print only failures.
    """

    def __init__(self, console: Console, bars: Progress | None, *, quiet: bool) -> None:
        self._console, self._bars, self._quiet = console, bars, quiet
        self._tasks: dict[str, TaskID] = {}
        self._shares: dict[str, float] = {}
        self._whole: TaskID | None = None
        self._total = self._made = self._ended = 0
        self._began: float | None = None

    def expect(self, total: int) -> None:
        """Set the number of samples."""
        self._total = total
        if self._bars is not None:
            self._whole = self._bars.add_task("all", total=total, stage="", left="")

    def started(self, entry: BatchEntry) -> None:
        """Work on a sample begins."""
        name = entry.sample.name
        self._began = self._began or time.monotonic()
        self._shares[name] = 0.0
        if self._bars is not None and name not in self._tasks:
            self._tasks[name] = self._bars.add_task(name, total=1.0, stage="waiting", left="")

    def progress(self, entry: BatchEntry, now: WorkProgress) -> None:
        """Update the progress of a sample."""
        name = entry.sample.name
        self._shares[name] = now.fraction
        if self._bars is not None and name in self._tasks:
            self._bars.update(self._tasks[name], completed=now.fraction, stage=now.stage)
            if self._whole is not None:
                self._bars.update(self._whole, left=self._left())

    def ended(self, entry: BatchEntry) -> None:
        """A sample is made, kept, failed or left."""
        name = entry.sample.name
        self._shares.pop(name, None)
        self._ended += 1
        if self._bars is not None:
            if name in self._tasks:
                self._bars.remove_task(self._tasks.pop(name))
            if self._whole is not None:
                self._bars.update(self._whole, completed=self._ended)
        count = f"[{self._ended}/{self._total}]" if self._total else ""
        if entry.state == "made":
            self._made += 1
            if not self._quiet:
                record = entry.record
                verdict = record["verdict"]["rating"]
                doubt = ", doubtful shot" if record["doubtful"] and verdict in _FIT else ""
                left = self._left()
                said = f"{count} {name}: {spoken_duration(record['seconds'])}, {verdict}{doubt}"
                self._say(f"{said}{f', {left}' if left else ''}")
        elif entry.state == "failed":
            self._say(f"{count} {name}: failed")

    def note(self, sentence: str) -> None:
        """Print a sentence, unless quiet."""
        if not self._quiet:
            self._say(sentence)

    def _left(self) -> str:
        """Remaining time in words; empty until a tenth of a sample is done."""
        done = self._made + sum(self._shares.values())
        if self._began is None or done < 0.1:
            return ""
        to_do = self._total - self._ended - sum(self._shares.values())
        return f"{spoken_duration((time.monotonic() - self._began) / done * max(0.0, to_do))} left"

    def _say(self, line: str) -> None:
        """Print a line as plain text, without markup or wrapping."""
        self._console.print(line.strip(), markup=False, highlight=False, soft_wrap=True)


@contextmanager
def batch_display(*, quiet: bool) -> Iterator[BatchDisplay]:
    """A display on stderr while the block runs."""
    console = Console(stderr=True)
    if quiet or not console.is_terminal or console.is_dumb_terminal:
        yield BatchDisplay(console, None, quiet=quiet)
        return
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[stage]}"),
        TextColumn("{task.fields[left]}", style="dim"),
    )
    with Progress(*columns, console=console, transient=True) as bars:
        yield BatchDisplay(console, bars, quiet=quiet)
