"""Options of `matcap view`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from matcap.files import settings as values
from matcap.files.settings import CheckedSettings, setting


@dataclass(frozen=True)
class ViewOptions(CheckedSettings):
    """Options of `matcap view`."""

    blend: Path | None = setting(None, metavar="FILE")
    """A second material to compare and blend with."""
    photo: Path | None = setting(None, metavar="FILE", otherwise="that of the folder")
    """A photograph to show next to the material."""
    seed: int = setting(0, metavar="SEED", parse=values.seed)
    """Seed of the realisation shown first."""
    port: int = setting(0, least=0, most=65535, otherwise="a free one")
    """Port of the server."""
    opens: bool = setting(True, option="open")
    """Open the page in the browser."""
    html: Path | None = setting(None, metavar="FILE")
    """Write a self-contained HTML file instead of running a server."""
    tile: int = setting(512, least=16, most=2048)
    """Side of the seamless tile in --html, in texels, a multiple of 16."""
