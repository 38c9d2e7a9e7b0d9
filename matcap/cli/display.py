"""Progress displays on stderr: live on a terminal, else plain lines."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from threading import Timer
from typing import TYPE_CHECKING, Any, ClassVar, Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)

from matcap.capture.settings import SHOWN_STAGES, RunStatus
from matcap.files.settings import spoken_duration
from matcap.photo.checks import Rating

if TYPE_CHECKING:
    from matcap.batch.work import BatchEntry
    from matcap.capture.settings import CaptureProgress
    from matcap.files.names import Progress as WorkProgress

_NAMED = (TextColumn("{task.description}", markup=False), BarColumn())
_PERCENT = TextColumn("{task.percentage:>3.0f} %")
_STAGE = TextColumn("{task.fields[stage]}")
_LEFT = TextColumn("{task.fields[left]}", style="dim")
_EVERY = 10.0  # seconds between lines where there is no terminal
_SHORT = 2.0  # seconds of work for which no bar is shown


class _Shown:
    """A display on a console.

    Args:
        bars: the live display; lines are printed where it is disabled.
        quiet: print only failures.
    """

    columns: ClassVar[tuple[ProgressColumn, ...]]
    """Of the live display."""
    indent: ClassVar[str] = ""
    """Before notes."""
    transient: ClassVar[bool] = False
    """Whether the live display goes at the end."""

    def __init__(self, console: Console, bars: Progress, *, quiet: bool) -> None:
        self._console, self._bars, self._quiet = console, bars, quiet
        self._prints = bars.disable and not quiet

    @classmethod
    @contextmanager
    def open(cls, *, quiet: bool) -> Iterator[Self]:
        """A display on stderr while the block runs."""
        console = Console(stderr=True)
        off = quiet or not console.is_terminal or console.is_dumb_terminal
        bars = Progress(*cls.columns, console=console, transient=cls.transient, disable=off)
        with nullcontext() if off else bars:
            yield cls(console, bars, quiet=quiet)

    def note(self, sentence: str) -> None:
        """Print a sentence, unless quiet."""
        if not self._quiet:
            self._say(f"{self.indent}{sentence}")

    def _say(self, line: str) -> None:
        """Print a line as plain text, without markup or wrapping."""
        self._console.print(line, markup=False, highlight=False, soft_wrap=True)


@contextmanager
def working(what: str, *, quiet: bool) -> Iterator[None]:
    """Say what a block of unknown duration does, if it takes longer than two seconds."""
    console = Console(stderr=True)
    if quiet:
        yield
    elif console.is_terminal and not console.is_dumb_terminal:
        with console.status(what):
            yield
    else:
        late = Timer(_SHORT, console.print, (f"  {what}",), {"markup": False, "highlight": False})
        late.daemon = True
        late.start()
        try:
            yield
        finally:
            late.cancel()


class CaptureDisplay(_Shown):
    """Shows the progress of captures."""

    columns = (*_NAMED, _STAGE, TextColumn("{task.fields[error]}", style="cyan"), _LEFT)
    indent = "  "
    _task: TaskID | None = None
    _stage, _status = "", RunStatus.DONE

    def started(self, photo: Path) -> None:
        """Begin the display of a photograph."""
        self._stage, self._status = "", RunStatus.DONE
        self._task = self._bars.add_task(photo.name, total=1.0, stage="reading", error="", left="")

    def progress(self, now: CaptureProgress) -> None:
        """Show the stage, the error and the remaining time."""
        error = ""
        left = "" if now.seconds_left is None else spoken_duration(now.seconds_left)
        stage = SHOWN_STAGES.get(now.stage, now.stage)
        if now.error is not None:
            error = f"differs {now.error:.2f} times as much as parts of the photograph"
        if self._task is not None:
            to_go = left and f"{left} left"
            self._bars.update(
                self._task, completed=now.fraction, stage=stage, error=error, left=to_go
            )
        if self._prints and stage != self._stage and now.stage != "read":
            # Without reading, so that an unreadable file prints only its error.
            self._say(f"  {now.seconds:6.1f} s  {stage}  {error}".rstrip())
        interrupted = now.status is RunStatus.INTERRUPTED
        if interrupted and now.status is not self._status and not self._quiet:
            soon = left and f", in about {left}"
            self._say(f"  interrupted: saving the best so far{soon}")
        self._stage, self._status = stage, now.status

    def finished(self, photo: Path, done: dict[str, Any]) -> None:
        """Print the folder, the verdict and notes of a completed capture."""
        self._end_bar()
        if not self._quiet:
            early = " (interrupted: the best so far)" if done["status"] == "interrupted" else ""
            self._say(f"{photo.name}: {done['folder']}, {spoken_duration(done['seconds'])}{early}")
            self._say(f"  {done['verdict']['sentence']}")
            for note in done["notes"]:
                self.note(note)

    def failed(self, photo: Path, sentence: str) -> None:
        """Print why a photograph could not be captured."""
        self._end_bar()
        self._say(f"matcap: {sentence}")

    def _end_bar(self) -> None:
        if self._task is not None:
            self._bars.remove_task(self._task)
            self._task = None


class ShareDisplay(_Shown):
    """Shows the share done, and the time left, of work that takes longer than two seconds."""

    columns = (*_NAMED, TimeRemainingColumn())
    transient = True

    def __init__(self, console: Console, bars: Progress, *, quiet: bool) -> None:
        super().__init__(console, bars, quiet=quiet)
        self._task = bars.add_task("", total=1.0, visible=False)
        self._began = self._printed = time.monotonic()

    def progress(self, share: float, work: str = "relighting") -> None:
        """Show the share done, in [0, 1], of the work named."""
        now = time.monotonic()
        long = now - self._began > _SHORT
        self._bars.update(self._task, completed=share, visible=long, description=work)
        if self._prints and now - self._printed >= _EVERY:
            self._printed = now
            self._say(f"  {100.0 * share:5.1f} %  {work}")


class BatchDisplay(_Shown):
    """Shows the progress of a batch."""

    columns = (*_NAMED, _PERCENT, _STAGE, _LEFT)
    transient = True

    def __init__(self, console: Console, bars: Progress, *, quiet: bool) -> None:
        super().__init__(console, bars, quiet=quiet)
        self._tasks: dict[str, TaskID] = {}
        self._shares: dict[str, float] = {}
        self._whole = bars.add_task("all", visible=False, stage="", left="")
        self._total = self._made = self._ended = 0
        self._began: float | None = None

    def expect(self, total: int) -> None:
        """Set the number of samples."""
        self._total = total
        self._bars.update(self._whole, total=total, visible=True)

    def started(self, entry: BatchEntry) -> None:
        """Work on a sample begins."""
        name = entry.sample.name
        self._began = self._began or time.monotonic()
        self._shares[name] = 0.0
        if name not in self._tasks:
            self._tasks[name] = self._bars.add_task(name, total=1.0, stage="waiting", left="")

    def progress(self, entry: BatchEntry, now: WorkProgress) -> None:
        """Update the progress of a sample."""
        name = entry.sample.name
        self._shares[name] = now.fraction
        if name in self._tasks:
            stage = SHOWN_STAGES.get(now.stage, now.stage)
            self._bars.update(self._tasks[name], completed=now.fraction, stage=stage)
            self._bars.update(self._whole, left=self._left())

    def ended(self, entry: BatchEntry) -> None:
        """A sample is made, kept, failed or left."""
        name = entry.sample.name
        self._shares.pop(name, None)
        self._ended += 1
        if name in self._tasks:
            self._bars.remove_task(self._tasks.pop(name))
        self._bars.update(self._whole, completed=self._ended)
        count = f"[{self._ended}/{self._total}] " if self._total else ""
        if entry.state == "made":
            self._made += 1
            if not self._quiet:
                record = entry.record
                verdict = record["verdict"]["rating"]
                quality = ", doubtful shot" if record["doubtful"] and Rating(verdict).fit else ""
                left = self._left()
                line = f"{count}{name}: {spoken_duration(record['seconds'])}, {verdict}{quality}"
                self._say(f"{line}{f', {left}' if left else ''}")
        elif entry.state == "failed":
            self._say(f"{count}{name}: failed")

    def _left(self) -> str:
        """Remaining time in words; empty until a tenth of a sample is done."""
        done = self._made + sum(self._shares.values())
        if self._began is None or done < 0.1:
            return ""
        to_do = self._total - self._ended - sum(self._shares.values())
        return f"{spoken_duration((time.monotonic() - self._began) / done * max(0.0, to_do))} left"
