"""The range of heights that all realisations of a material share."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from matcap.errors import MatcapError
from matcap.export.job import roomy


def material_reach(path: Path, name: str) -> float | None:
    """How far coded heights reach above and below the undisplaced level, in plane units.

    From the photographed piece, which every realisation rearranges, with room above it.

    Args:
        path: what is exported: a material, or the JSON file or the folder of a map set.
        name: of the map set, whose material has the same and may lie beside it.

    Returns:
        None where there is no material with an exemplar: the maps themselves decide.
    """
    from matcap.field.material import Material

    folder = path if path.is_dir() else path.parent
    file = path if path.suffix.lower() == ".matcap" else folder / f"{name}.matcap"
    piece = None
    if file.is_file():
        # What is exported was read; a material beside it that is broken only has no say.
        with suppress(MatcapError):
            piece = Material.load(file).generator.piece()
    if piece is None:
        return None
    return roomy(float(piece.height.abs().amax()))
