"""The `matcap` command: subcommands, exit codes and error messages.

Nothing heavy is imported here or by the command modules; each command imports what it needs when
it runs, so that --help is instant.
"""

from __future__ import annotations

import errno
import os
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache, partial
from importlib import import_module
from typing import Annotated, TextIO

import typer

from matcap.cli.options import ALL, PlainCommand
from matcap.errors import ExitCode, MatcapError
from matcap.files.names import MAKER, Note
from matcap.files.process import ignore_signals, keep_memory, raise_on_signals

_REPORT = "please report it with the output of the same command under MATCAP_DEBUG=1"

# Module of each command, whose function has its name. All of them take a fifth of a second to load.
_COMMANDS = {
    "capture": "capture", "batch": "capture", "inspect": "inspect", "synth": "synth",
    "relight": "relight", "export": "synth", "view": "relight", "blend": "synth",
    "sample": "synth", "doctor": "doctor",
}  # fmt: skip


@cache
def command_line(*names: str) -> typer.Typer:
    """The command line with these commands alone, or all of them."""
    program = typer.Typer(
        name="matcap",
        help="One phone flash photograph in, an endless generator of SVBRDF maps out. After "
        'Henzler, Deschaintre, Mitra and Ritschel 2021, "Generative Modelling of BRDF Textures '
        'from Flash Images": their generator is --generator decoder; the default rearranges the '
        "maps of the photographed rectangle (docs/guide/paper.md).",
        epilog="Exit codes: 0 done, 1 internal error, 2 wrong usage, 3 nothing succeeded, "
        "4 some inputs failed, 130 interrupted.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode="rich",
    )
    program.callback()(_matcap)
    for name in names or _COMMANDS:
        module = import_module(f"matcap.cli.{_COMMANDS[name]}")
        kind = module.SynthCommand if name == "synth" else PlainCommand
        settings = {"help_option_names": ["--help", ALL]}
        program.command(name, cls=kind, context_settings=settings)(getattr(module, name))
    return program


def _named(arguments: Sequence[str]) -> Sequence[str]:
    """The command that arguments begin with, if they do."""
    return [name for name in arguments[:1] if name in _COMMANDS]


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(MAKER)
        raise typer.Exit


def _print_cost(start: float) -> None:
    """Print the command's time and memory on stderr."""
    cost = f"{MAKER}: {time.perf_counter() - start:.1f} s"
    if sys.platform == "linux":
        import resource

        cost += f", at most {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3:.0f} MB"
    typer.echo(cost, err=True)


def _matcap(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Print the command's time and memory.")
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help="Show tracebacks of failures, as MATCAP_DEBUG=1 does.")
    ] = False,
) -> None:
    if verbose:
        context.call_on_close(partial(_print_cost, time.perf_counter()))
    del debug  # main() parses it, as a failed command has no context


def main(
    arguments: Sequence[str] | None = None,
    *,
    program: typer.Typer | None = None,
    interrupted: Callable[[], bool] = lambda: False,
) -> int:
    """Run the command line and return its exit code; failures become one sentence on stderr.

    Args:
        arguments: command line; None for that of the process.
        program: another one's commands; None for matcap's.
        interrupted: callback, whether a signal arrived; an interrupted library may raise any error.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    warnings.showwarning = partial(_show_warning, quiet=bool({"-q", "--quiet"} & {*arguments}))
    debug = "--debug" in arguments or os.environ.get("MATCAP_DEBUG", "0") not in ("", "0")
    try:
        program = program or command_line(*_named(arguments))
        program(args=arguments, prog_name=program.info.name)
    except SystemExit as stop:
        if isinstance(getattr(stop.__context__, "__cause__", None), KeyboardInterrupt):
            return _end_early()  # as typer does for one that no command handled
        return stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    except MatcapError as error:
        return _show(error, debug=debug)
    except KeyboardInterrupt:
        return _end_early()
    except Exception as error:
        return _end_early() if interrupted() else _show(_explained(error), debug=debug)
    return ExitCode.DONE


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
    *,
    quiet: bool,
) -> None:
    """Notes are sentences for the user; other warnings are printed as Python prints them."""
    if not issubclass(category, Note):
        typer.echo(warnings.formatwarning(message, category, filename, lineno, line), err=True)
    elif not quiet:
        typer.echo(f"note: {message}", err=True)


def run(program: typer.Typer | None = None) -> None:
    """The console script of matcap, or of another program with the same errors and exit codes."""
    # Long spinning of waiting threads makes a shared machine many times slower; no spinning halves
    # the speed of fine-tuning. OpenMP reads this when torch loads. A user's setting is kept.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    os.environ.setdefault("GOMP_SPINCOUNT", "2000")
    # NumPy's matrices are small here: on a shared machine its threads spin twenty times as long as
    # they compute.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    keep_memory()  # before large libraries are imported: this process is matcap's own
    program = program or command_line(*_named(sys.argv[1:]))  # before signals are errors
    came = raise_on_signals()
    code = main(program=program, interrupted=came)
    ignore_signals()
    code = _flushed(code)
    if sys.getprofile() or sys.gettrace():  # these write at exit
        sys.exit(code)
    os._exit(code)  # freeing all modules and objects takes 0.1 s with torch loaded


def _flushed(code: int) -> int:
    """The exit code after flushing stdout and stderr, which are None where they are closed.

    A failure to flush stdout gives its own code.
    """
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError as error:
        # Python would flush again at exit, and print its own message.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if error.errno == errno.ENOSPC and not code:
            code = _show(_explained(error), debug=False)
    with suppress(OSError, AttributeError):
        sys.stderr.flush()
    return code


def _explained(error: Exception) -> Exception:
    """The MatcapError of a failure to write to stdout or to use a file; other errors themselves.

    Other files are written through files/output.py. A file cannot be used where its name is too
    long, or a parent folder is not readable.
    """
    if not isinstance(error, OSError):
        return error
    if error.errno == errno.ENOSPC:
        shown = MatcapError.at("standard output", "the disk is full", "free some space")
    elif error.filename is not None:
        why = (error.strerror or type(error).__name__).lower()
        where = str(error.filename)[:200]
        shown = MatcapError.at(where, f"cannot be used ({why})", "give another file")
    else:
        return error
    shown.__cause__ = error
    return shown


def _end_early() -> ExitCode:
    typer.echo("matcap: interrupted.", err=True)
    return ExitCode.INTERRUPTED


def _show(error: Exception, *, debug: bool) -> ExitCode:
    """Print an error, and return the exit code."""
    if debug:
        import traceback

        traceback.print_exception(error)
    elif isinstance(error, MatcapError):
        typer.echo(f"matcap: {error}", err=True)
    else:
        kind = type(error).__name__
        typer.echo(f"matcap: internal error ({kind}: {error}); {_REPORT}.", err=True)
    return error.exit_code if isinstance(error, MatcapError) else ExitCode.INTERNAL
