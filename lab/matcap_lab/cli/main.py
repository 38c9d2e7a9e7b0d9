"""The `matcap-lab` command: what measures matcap and trains its networks."""

from __future__ import annotations

from collections.abc import Sequence

import typer
from typer.core import TyperCommand

from matcap.cli import main as product
from matcap.cli.options import PlainCommand
from matcap_lab.cli import bench, inverse, prior

app = typer.Typer(
    name="matcap-lab",
    help="Measure matcap on simulated photographs with known truth, and train its networks.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
for _name, _part in (("bench", bench.app), ("prior", prior.app), ("inverse", inverse.app)):
    app.add_typer(_part, name=_name)
    for _command in _part.registered_commands:
        _command.cls = PlainCommand if _command.cls is TyperCommand else _command.cls


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code, as the product's."""
    return product.main(arguments, program=app)


def run() -> None:
    """The console script."""
    product.run(app)
