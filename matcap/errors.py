"""The base class of errors that users see, and the exit codes of the command line."""

from __future__ import annotations

from enum import IntEnum
from typing import ClassVar, Self


class ExitCode(IntEnum):
    """Exit code of a command."""

    DONE = 0
    """Done."""
    INTERNAL = 1
    """An internal error: please report it, with the output under `MATCAP_DEBUG=1`."""
    USAGE = 2
    """Wrong usage."""
    NOTHING_SUCCEEDED = 3
    """All inputs failed."""
    SOME_FAILED = 4
    """Some inputs failed, the others are done."""
    INTERRUPTED = 130
    """Interrupted; finished outputs are kept."""

    @classmethod
    def of(cls, good: int, total: int) -> ExitCode:
        """Exit code of a command of which `good` of `total` inputs succeeded."""
        if good == total:
            return cls.DONE
        return cls.SOME_FAILED if good else cls.NOTHING_SUCCEEDED


class MatcapError(Exception):
    """An error that the user can correct, printed as one sentence: where, what and remedy.

    Chain the cause with ``raise ... from``.

    Args:
        what: the fault, in lower case, without a final stop ("the file is empty").
        where: the file, option or tensor, or "".
        remedy: an instruction ("photograph again with the flash on"), or "".
    """

    exit_code: ClassVar[ExitCode] = ExitCode.NOTHING_SUCCEEDED
    """Of the command."""

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        self.what = what
        self.where = where
        self.remedy = remedy
        super().__init__(self.sentence())

    @classmethod
    def at(cls, where: object, what: str, remedy: str) -> Self:
        """The error in the order of its sentence; `where` may be a path."""
        return cls(what, where=str(where), remedy=remedy)

    def sentence(self) -> str:
        """The error as one line: where, what, remedy."""
        text = f"{self.where}: {self.what}" if self.where else self.what
        text = f"{text}; {self.remedy}." if self.remedy else f"{text}."
        # A file's name may have control characters.
        return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)

    def __reduce__(self) -> tuple[object, ...]:
        # Pickling between processes would otherwise lose keyword arguments.
        return (type(self).at, (self.where, self.what, self.remedy))


class UsageError(MatcapError):
    """An error of the call itself, such as an option's value or a missing argument."""

    exit_code = ExitCode.USAGE
