"""Options that several commands share."""

from __future__ import annotations

from enum import Enum
from typing import Annotated

import typer


class Normal(Enum):
    """Which way green points in a normal map."""

    gl = "gl"
    dx = "dx"


NormalOption = Annotated[Normal, typer.Option(help="Normals with +Y up (gl) or down (dx).")]
PngOption = Annotated[bool, typer.Option("--png", help="16-bit PNGs beside the EXR files.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the results as JSON.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but failures.")]
