"""The one error that users see, and the exit codes of the command line."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """What the process answers to its shell.

    Attributes:
        DONE: done.
        INTERNAL: an internal error: please report it, with the output under `MATCAP_DEBUG=1`.
        USAGE: wrong usage.
        NOTHING_SUCCEEDED: nothing succeeded; one file that cannot be read is nothing, too.
        SOME_FAILED: some inputs failed, the others are done.
        INTERRUPTED: interrupted; what is whole is there.
    """

    DONE = 0
    INTERNAL = 1
    USAGE = 2
    NOTHING_SUCCEEDED = 3
    SOME_FAILED = 4
    INTERRUPTED = 130


class MatcapError(Exception):
    """Something the user can act on: what is wrong, where, and what to do about it.

    Printed as one sentence, ``where: what; remedy.``  Chain the cause with ``raise ... from``.

    Args:
        what: the fault, in lower case, without a final stop ("the file is empty").
        where: the file, option or tensor it was found in, or "" when the fault has no place.
        remedy: an instruction ("photograph again with the flash on"), or "".
        exit_code: what the command line answers; NOTHING_SUCCEEDED unless the call was wrong.
    """

    def __init__(
        self,
        what: str,
        *,
        where: str = "",
        remedy: str = "",
        exit_code: ExitCode = ExitCode.NOTHING_SUCCEEDED,
    ) -> None:
        self.what = what
        self.where = where
        self.remedy = remedy
        self.exit_code = exit_code
        super().__init__(self.sentence())

    def sentence(self) -> str:
        """One line: where, what, remedy."""
        text = f"{self.where}: {self.what}" if self.where else self.what
        text = f"{text}; {self.remedy}." if self.remedy else f"{text}."
        # A file's name may hold anything, even what moves a terminal's cursor.
        return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)

    def __reduce__(self) -> tuple[object, ...]:
        # Exceptions cross process boundaries in parallel work; keyword arguments must survive.
        return (_rebuild, (self.what, self.where, self.remedy, self.exit_code))


def _rebuild(what: str, where: str, remedy: str, exit_code: ExitCode) -> MatcapError:
    return MatcapError(what, where=where, remedy=remedy, exit_code=exit_code)


class UsageError(MatcapError):
    """The call itself is wrong: an option's value, a size of zero, a missing argument."""

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        super().__init__(what, where=where, remedy=remedy, exit_code=ExitCode.USAGE)

    def __reduce__(self) -> tuple[object, ...]:
        return (_rebuild_usage, (self.what, self.where, self.remedy))


def _rebuild_usage(what: str, where: str, remedy: str) -> UsageError:
    return UsageError(what, where=where, remedy=remedy)
