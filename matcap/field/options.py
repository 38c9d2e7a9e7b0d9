"""Options of reading maps from a material or a map set, shared by several commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from matcap.files.settings import CheckedSettings, setting

if TYPE_CHECKING:
    from matcap.brdf.adjust import Adjustments
    from matcap.brdf.stated import NormalSource
    from matcap.field.source import Generator


def _adjustments(text: str | Adjustments) -> Adjustments:
    """parse_adjustments, imported on demand as it needs NumPy."""
    from matcap.brdf.adjust import parse_adjustments

    return parse_adjustments(text) if isinstance(text, str) else text


@dataclass(frozen=True)
class ReadOptions(CheckedSettings):
    """Options of reading maps."""

    generator: Generator | None = setting(
        None,
        words=("example", "decoder"),
        otherwise="example, where the material has an exemplar",
    )
    """Rearrange the photographed rectangle (example), or run the fine-tuned network (decoder)."""
    adjust: Adjustments | None = setting(None, metavar="NAME=VALUE,...", parse=_adjustments)
    """Change relief (factor), roughness (added), saturation, brightness (factors) or tint (#rrggbb)
    of the maps, not of the material: relief=1.3,roughness=-0.1. Or a sidecar (.json) that records
    it."""
    variety: float | None = setting(
        None, least=0.0, most=1.0, metavar="0..1", otherwise="what capture chose"
    )
    """Size of the patches that the exemplar is cut into: 0 is one patch, the whole exemplar; 1 is
    the smallest patches."""
    normals: NormalSource | None = setting(None, words=("height", "file"), otherwise="height")
    """Normals of a map set: computed from its height, or read from its normal file."""

    @property
    def adjustments(self) -> Adjustments:
        """The adjustments; NONE where there are none."""
        from matcap.brdf.adjust import NONE

        return self.adjust or NONE


AS_IT_IS = ReadOptions()
