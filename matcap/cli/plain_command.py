"""A command whose help shows no type for options that take no value."""

from __future__ import annotations

from typing import Any

from typer.core import TyperCommand


class PlainCommand(TyperCommand):
    """Typer's command, without `<bool>` in the help of flags."""

    def get_params(self, ctx: Any) -> list[Any]:  # noqa: ANN401
        """All parameters including `--help`, flags without a type."""
        params = super().get_params(ctx)
        for param in params:
            if getattr(param, "is_flag", False) and param.metavar is None:
                param.metavar = ""
        return params
