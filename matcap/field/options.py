"""How maps are read of a material or a map set: options that several commands share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from matcap.files.settings import check_settings, setting

if TYPE_CHECKING:
    from matcap.brdf.adjust import Adjustments
    from matcap.brdf.stated import NormalSource
    from matcap.field.source import Generator


def _adjustments(text: str | Adjustments) -> Adjustments:
    """As parse_adjustments, which needs NumPy."""
    from matcap.brdf.adjust import parse_adjustments

    return parse_adjustments(text) if isinstance(text, str) else text


@dataclass(frozen=True)
class ReadOptions:
    """Which of a material's maps are read, and what is changed of them on their way.

    Raises:
        UsageError: a word or a number that there is not.
    """

    generator: Generator | None = setting(
        None,
        words=("example", "decoder"),
        otherwise="example, where the material has an exemplar",
    )
    """Rearrange the photographed piece (example), or ask the network (decoder)."""
    adjust: Adjustments | None = setting(None, metavar="NAME=VALUE,...", parse=_adjustments)
    """Change relief (factor), roughness (added), saturation, brightness (factors) or tint (#rrggbb)
    of the maps, not of the material: relief=1.3,roughness=-0.1. Or a sidecar (.json) that records
    it."""
    variety: float | None = setting(
        None, least=0.0, most=1.0, metavar="0..1", otherwise="what capture chose"
    )
    """How far the photographed piece is taken apart: 0 repeats it whole, its borders healed; 1
    makes many small pieces of it."""
    normals: NormalSource | None = setting(None, words=("height", "file"), otherwise="height")
    """Of a map set: normals of its height, or of its normal file, where you painted on it."""

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def adjustments(self) -> Adjustments:
        """What is changed; NONE where nothing is."""
        from matcap.brdf.adjust import NONE

        return self.adjust or NONE


AS_IT_IS = ReadOptions()
