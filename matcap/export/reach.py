"""The height range that all realisations of a material share."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from matcap.errors import MatcapError
from matcap.export.job import roomy


def material_reach(path: Path, name: str) -> float | None:
    """Largest absolute height that coded heights hold, in plane units (ExportJob.reach).

    That of the exemplar, which every realisation rearranges, rounded up (roomy).

    Args:
        path: a material, or the JSON document or folder of a map set.
        name: of the map set; its material is NAME.matcap in the same folder.

    Returns:
        None without a material that has an exemplar.
    """
    from matcap.field.material import Material

    folder = path if path.is_dir() else path.parent
    file = path if path.suffix.lower() == ".matcap" else folder / f"{name}.matcap"
    piece = None
    if file.is_file():
        # The maps have been read; a damaged material in their folder is ignored.
        with suppress(MatcapError):
            piece = Material.load(file).generator.piece()
    if piece is None:
        return None
    return roomy(float(piece.height.abs().amax()))
