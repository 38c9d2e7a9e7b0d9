"""Entry point; Ctrl-C ends the process without a traceback until the command line is loaded."""

from __future__ import annotations

import signal


def run() -> None:
    """The console script."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from matcap.cli.main import run

    run()


if __name__ == "__main__":
    run()
