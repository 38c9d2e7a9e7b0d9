"""The command reference: whole, right, and as new as the commands."""

from pathlib import Path

import pytest
import typer.main

from matcap.cli.main import app
from matcap.cli.reference import reference

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "commands.md"


def parsers(command, name="matcap"):
    """(name, parser) of every command, as typer makes them."""
    yield name, command
    for word, one in getattr(command, "commands", {}).items():
        yield from parsers(one, f"{name} {word}")


PARSERS = [
    (name, parser)
    for name, parser in parsers(typer.main.get_command(app))
    if name == "matcap" or not hasattr(parser, "commands")
]


def test_the_page_is_as_new_as_the_commands():
    assert PAGE.read_text(encoding="utf-8") == reference(), (
        "write it again: python -m matcap.cli.reference > docs/commands.md"
    )


@pytest.mark.parametrize(("name", "parser"), PARSERS, ids=[name for name, _ in PARSERS])
def test_every_option_of_every_command_is_there(name, parser):
    section = reference().split(f"\n## {name}\n")[1].split("\n## ")[0]
    for parameter in parser.params:
        if parameter.param_type_name == "option" and parameter.name not in (
            "help", "install_completion", "show_completion",
        ):  # fmt: skip
            for option in parameter.opts:
                assert f"`{option}`" in section
