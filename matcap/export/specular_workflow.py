"""Conversion to the specular workflow: base colour under a specular layer of any F0.

The base colour is raised by what the layer darkens in the target's shading model (fit.py); values
above 1 are clipped, with a note.
"""

from __future__ import annotations

from matcap.export.fit import fitted_tables
from matcap.export.formats import Picture, bands
from matcap.export.job import ExportJob, MapRows
from matcap.export.shading import TargetShading


def base_colour(piece: MapRows, shading: TargetShading) -> Picture:
    """(H, W, 3) base colour that the target renders as the diffuse albedo; may exceed 1."""
    share = fitted_tables(shading).albedo(piece.picture("specular"), piece.picture("roughness"))
    return piece.picture("diffuse") * share


def specular_colour(piece: MapRows, shading: TargetShading) -> Picture:
    """(H, W[, 3]) F0 that the target renders as the maps' F0; may exceed 1."""
    return fitted_tables(shading).f0(piece.picture("specular"), piece.picture("roughness"))


def brightest(job: ExportJob, shading: TargetShading) -> float:
    """Largest specular_colour of the maps."""
    peaks = (specular_colour(piece, shading).max() for piece in _bands(job))
    return max(1e-4, *(float(one) for one in peaks), 0.0)


def clipping_notes(job: ExportJob, shading: TargetShading) -> tuple[str, ...]:
    """Note on texels whose base colour exceeds 1."""
    bands = _bands(job)
    over = sum(int((base_colour(piece, shading).max(axis=-1) > 1.0).sum()) for piece in bands)
    if not over:
        return ()
    width, height = job.maps.size
    return (
        f"{over / (width * height):.2%} of the texels reflect more than a layered model allows; "
        "their base colour is clipped",
    )


def _bands(job: ExportJob) -> list[MapRows]:
    _, height = job.maps.size
    return [job.piece(rows) for rows in bands(height)]
