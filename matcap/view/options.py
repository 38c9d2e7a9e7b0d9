"""Options of `matcap view`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from matcap.files import values
from matcap.files.settings import check_settings, setting


@dataclass(frozen=True)
class ViewOptions:
    """What the page shows, and where it stands.

    Raises:
        UsageError: a number that is out of range.
    """

    blend: Path | None = setting(None, metavar="FILE")
    """A second material to walk towards."""
    photo: Path | None = setting(None, metavar="FILE", otherwise="what the folder has")
    """A photograph to show beside the piece."""
    seed: int = setting(0, metavar="SEED", parse=values.seed)
    """Which piece is shown first."""
    port: int = setting(0, least=0, most=65535, otherwise="a free one")
    """Of the server."""
    opens: bool = setting(True, option="open")
    """Open the page in the browser."""
    html: Path | None = setting(None, metavar="FILE")
    """Write one self-contained page instead of serving one."""
    tile: int = setting(512, least=16, most=2048)
    """Side of the repeating tile in --html, a multiple of 16."""

    def __post_init__(self) -> None:
        check_settings(self)
