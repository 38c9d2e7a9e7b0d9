"""Exit codes and errors, from `matcap.errors`."""

from __future__ import annotations

from matcap.errors import ExitCode, MatcapError, UsageError
from matcap.files.settings import field_docs
from reference.docstrings import read, table


def page() -> str:
    """The page, in Markdown."""
    documented = field_docs(ExitCode)
    lines = ["# Exit codes", "", f"{read(ExitCode).text}", ""]
    lines += table(
        ["code", "name", "meaning"],
        ([str(int(code)), f"`{code.name}`", documented[code.name]] for code in ExitCode),
    )
    lines += ["Results go to stdout (`--json` where a command has it), progress and messages to"]
    lines += ["stderr.", "", "## Errors", ""]
    for error in (MatcapError, UsageError):
        found = read(error)
        lines += [f"### `{error.__module__}.{error.__name__}`", "", found.text, ""]
        if "Args" in found.sections:
            lines += table(["", ""], ([f"`{k}`", v] for k, v in found.entries("Args").items()))
    return "\n".join(lines)
