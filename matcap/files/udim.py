"""UDIM texture sets: tiles numbered 1001 + column + 10 row from the bottom left."""

from __future__ import annotations

from matcap.errors import UsageError

TOKEN = "<UDIM>"  # stands for a tile's number in file names
_COLUMNS, _ROWS = 10, 900


def tile_number(column: int, row: int) -> int:
    """Number of a tile; (0, 0) is the bottom left one, 1001."""
    return 1001 + column + 10 * row


def tile_names(name: str, grid: tuple[int, int] | None) -> list[str]:
    """File names of a texture of (columns, rows) tiles, from the bottom row; None is one tile."""
    columns, rows = grid or (1, 1)
    numbers = [tile_number(column, row) for row in range(rows) for column in range(columns)]
    return [name.replace(TOKEN, str(number)) for number in numbers]


def check_grid(columns: int, rows: int, where: str = "") -> None:
    """Raise UsageError for a texture set of too many tiles, or none; it names `where`."""
    if not (1 <= columns <= _COLUMNS and 1 <= rows <= _ROWS):
        raise UsageError.at(
            where,
            f"a texture set cannot have {columns}x{rows} tiles",
            f"ask for at most {_COLUMNS} columns and {_ROWS} rows",
        )
