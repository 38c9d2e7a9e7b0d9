"""Options of `matcap relight`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from matcap.files import settings as values
from matcap.files.settings import CheckedSettings, setting
from matcap.relight.effects.bound import DEFAULT_TOLERANCE

if TYPE_CHECKING:
    from matcap.brdf.stated import NormalStyle
    from matcap.files.settings import Size


_LARGEST = 32768  # pixels of a side
_MOST_FRAMES, _MOST_LIGHTS = 10_000, 64


@dataclass(frozen=True)
class RelightOptions(CheckedSettings):
    """Settings of a rendering: light, camera, size and accuracy."""

    light: Sequence[str] = setting(
        (), several=True, metavar="NAME|x,y,z[,intensity]", otherwise="top"
    )
    """A named light (flash, top, left, right, bottom), or the place of a point light. Of what was
    photographed, flash is the photograph's own: its camera, exposure and vignetting. Given several
    times, the lights add up."""
    scene: str | None = setting(None, metavar="FILE|NAME")
    """A scene file (.toml), the name of a light, studio, sunset or turntable."""
    size: Size | None = setting(None, metavar="WxH", parse=values.sides(_LARGEST))
    """Pixels of the picture, at most 32768 a side; by default the scene's, or one a texel of a map
    set."""
    seed: int = setting(0, metavar="SEED", parse=values.seed)
    """Seed of the material's realisation."""
    effects: str = setting("auto", metavar="auto|all|none|+x,-y")
    """Effects to run (see --explain)."""
    tolerance: float = setting(
        DEFAULT_TOLERANCE, least=0.0, most=1e9, metavar="0..1e9", otherwise="half an 8-bit step"
    )
    """Largest change by skipped effects, in code values from 0 to 1."""
    explain_map: Path | None = setting(None, metavar="FILE.png")
    """A picture of the tiles that each effect ran in."""
    animate: Literal["light-orbit", "turntable"] | None = setting(
        None, words=("light-orbit", "turntable")
    )
    """Animation to .gif, .mp4 or numbered .exr."""
    frames: int = setting(48, least=1, most=_MOST_FRAMES)
    """Frames of the animation."""
    sheet: Size | None = setting(None, metavar="COLUMNSxROWS", parse=values.sides(_MOST_LIGHTS))
    """A grid of lights in one picture, at most 64 a side."""
    maps_from: Path | None = setting(None)
    """A folder of maps that matcap did not make (ambientCG, Poly Haven names)."""
    normal: NormalStyle | None = setting(None, words=("gl", "dx"))
    """Direction of green in normal maps of --maps-from: up (gl) or down (dx)."""
