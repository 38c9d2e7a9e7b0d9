"""`matcap bench`: the commands that measure what the documentation claims."""

from __future__ import annotations

import typer

app = typer.Typer(help="Measure matcap on this machine.", no_args_is_help=True)


@app.callback()
def _bench() -> None:
    """Measure matcap on this machine."""
