"""Progress display of captures on stderr: live on a terminal, plain lines elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn

from matcap.files.values import spoken_duration

if TYPE_CHECKING:
    from matcap.capture.progress import CaptureProgress


class Display:
    """Shows the progress of captures on a console.

    Args:
        console: the console to print on.
        bars: the live display, or None to print lines.
        quiet: print only failures.
    """

    def __init__(self, console: Console, bars: Progress | None, *, quiet: bool) -> None:
        self._console = console
        self._bars = bars
        self._quiet = quiet
        self._task: TaskID | None = None
        self._stage, self._interrupted = "", False

    def started(self, photo: Path) -> None:
        """Begin the display of a photograph."""
        self._stage, self._interrupted = "", False
        if self._bars is not None:
            self._task = self._bars.add_task(
                photo.name, total=1.0, stage="reading", error="", left=""
            )

    def progress(self, now: CaptureProgress) -> None:
        """Show the stage, the error and the remaining time."""
        error = ""
        left = "" if now.seconds_left is None else spoken_duration(now.seconds_left)
        if now.error is not None:
            error = f"texture distance {now.error:.2f} times that between parts of the photograph"
        if now.in_a_minute is not None:
            error += f" ({now.in_a_minute:.2f} after another minute)"
        if self._bars is not None and self._task is not None:
            to_go = left and f"{left} left"
            self._bars.update(
                self._task, completed=now.fraction, stage=now.stage, error=error, left=to_go
            )
        elif not self._quiet and now.stage not in (self._stage, "read"):
            # Without the stage `read`, so that an unreadable file prints only its error.
            self._say(f"  {now.seconds:6.1f} s  {now.stage}  {error}".rstrip())
        if now.interrupted and not self._interrupted and not self._quiet:
            soon = left and f", in about {left}"
            self._say(f"  interrupted: saving the best so far{soon}")
        self._stage, self._interrupted = now.stage, now.interrupted

    def finished(self, photo: Path, done: dict[str, Any]) -> None:
        """Print the folder, the verdict and notes of a completed capture."""
        self._end_bar()
        if not self._quiet:
            early = " (interrupted: the best so far)" if done["status"] == "interrupted" else ""
            self._say(f"{photo.name}: {done['folder']}, {spoken_duration(done['seconds'])}{early}")
            self._say(f"  {done['verdict']['sentence']}")
            for note in done["notes"]:
                self.note(note)

    def note(self, sentence: str) -> None:
        """Print a sentence, unless quiet."""
        if not self._quiet:
            self._say(f"  {sentence}")

    def failed(self, photo: Path, sentence: str) -> None:
        """Print why a photograph could not be captured."""
        self._end_bar()
        self._say(f"matcap: {sentence}")

    def _end_bar(self) -> None:
        if self._bars is not None and self._task is not None:
            self._bars.remove_task(self._task)
            self._task = None

    def _say(self, line: str) -> None:
        """Print a line as plain text, without markup or wrapping."""
        self._console.print(line, markup=False, highlight=False, soft_wrap=True)


@contextmanager
def display(*, quiet: bool) -> Iterator[Display]:
    """A display on stderr while the block runs."""
    console = Console(stderr=True)
    if quiet or not console.is_terminal or console.is_dumb_terminal:
        yield Display(console, None, quiet=quiet)
        return
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.fields[stage]}"),
        TextColumn("{task.fields[error]}", style="cyan"),
        TextColumn("{task.fields[left]}", style="dim"),
    )
    with Progress(*columns, console=console) as bars:
        yield Display(console, bars, quiet=quiet)
