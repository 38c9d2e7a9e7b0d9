"""Every target that maps can be exported to, and the one function that writes them.

What a target's folder holds, `NAME_TARGET.json` tells.

Keys:
    format: "matcap export".
    version: 1.
    matcap: version of the program that wrote it.
    target: or preset.
    name: of the map set.
    width: texels.
    height: texels; where the target stores heights, their `scale`, `midlevel` and `unit` instead.
    unit: what lengths are told in, "mm" or "plane unit".
    tile: (width, height) of the piece in that unit.
    periodic: whether it repeats without a seam.
    seam: step across the border over steps inside, about 1 without a seam.
    files: for each texture its `colour_space`, `depth` and `meaning`.
    documents: names of the other files.
    residual: `mean` and `worst` share of the light that differs from matcap's; null for plain maps.
    notes: what must be known, a sentence each.
    textures: of Blender alone, the file of each map.
    provenance: how the material was made.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matcap.brdf.seam import seam_ratio
from matcap.export.blender import blender
from matcap.export.gltf import gltf
from matcap.export.materialx import materialx
from matcap.export.mitsuba import mitsuba
from matcap.export.names import known
from matcap.export.presets import PRESETS as PRESETS
from matcap.export.presets import PresetOptions, pack
from matcap.export.surface import Residual, residual
from matcap.export.textures import Export, ExportJob
from matcap.export.usd import usd
from matcap.files.maker import MAKER_VERSION
from matcap.files.staging import staged

FORMAT = "matcap export"
VERSION = 1

_SEAM = (
    "These maps do not repeat: there is a seam where they meet themselves. Export the material, "
    "at sides that are multiples of 16, for maps without one."
)

# All maps twice, in 32-bit floats: no target takes more.
_TEXEL_BYTES = 2 * 4 * (3 + 1 + 1 + 1 + 3)

# Targets with a document of their own.
DOCUMENTS: dict[str, Callable[[ExportJob], Export]] = {
    "materialx": materialx,
    "usd": usd,
    "gltf": gltf,
    "blender": blender,
    "mitsuba": mitsuba,
}


@dataclass(frozen=True)
class Exported:
    """What was written.

    Attributes:
        folder: where.
        files: names in it, sorted.
        residual: how far the target's light is from matcap's; None for plain maps.
        notes: what the user must know, a sentence each.
    """

    folder: Path
    files: tuple[str, ...]
    residual: Residual | None
    notes: tuple[str, ...]


def check_target(*, to: str | None = None, preset: str | None = None) -> str:
    """The name of a document's target or of a preset, whichever is given.

    Raises:
        UsageError: there is no such name.
    """
    if to is not None:
        return known(to, DOCUMENTS, "--to")
    return known(preset or "", PRESETS, "--preset")


def check_targets(names: Sequence[str], where: str = "--export") -> tuple[str, ...]:
    """Names of documents' targets or presets, each once, in their order; "gltf" is the document.

    Raises:
        UsageError: there is no such name.
    """
    return tuple(dict.fromkeys(known(name, (*DOCUMENTS, *PRESETS), where) for name in names))


def export_mapset(folder: Path, target: str) -> Exported:
    """Write the map set of a folder once more, for a target, into a folder of its name inside.

    Args:
        folder: holds one map set, or is the JSON file of one.
        target: as write_export.

    Raises:
        UsageError: no such target.
        MatcapError: no map set, a full disk, an unwritable folder.
    """
    from matcap.model.opened import open_tile

    found = open_tile(folder)
    place = folder if folder.is_dir() else folder.parent
    job = ExportJob(found.maps, found.name, provenance=found.provenance)
    return write_export(job, target, place / target)


def export_bytes(width: int, height: int) -> int:
    """Disk space that an export of this size takes at most."""
    return width * height * _TEXEL_BYTES + 1_000_000


def write_export(
    job: ExportJob, target: str, folder: Path, choice: PresetOptions | None = None
) -> Exported:
    """Write maps for a target, all files or none.

    Args:
        job: the maps and how to write them.
        target: a key of DOCUMENTS or of presets.PRESETS; "gltf" is the document.
        folder: made when missing; files of the same names are replaced.
        choice: for presets only.

    Raises:
        UsageError: no such target, or one that does not know the choice.
        MatcapError: values that are not finite, a full disk, an unwritable folder.
    """
    if target in DOCUMENTS:
        return _write(DOCUMENTS[target](job), job, target, folder)
    return write_preset(job, target, folder, choice)


def write_preset(
    job: ExportJob, preset: str, folder: Path, choice: PresetOptions | None = None
) -> Exported:
    """Write loose textures under a preset's names, all files or none.

    Raises:
        UsageError: no such preset, or a choice that does not fit it.
        MatcapError: as write_export.
    """
    return _write(pack(job, preset, choice), job, preset, folder)


def _write(made: Export, job: ExportJob, target: str, folder: Path) -> Exported:
    """Write what an exporter made, and its sidecar NAME_TARGET.json."""
    off = residual(job.maps, made.surface) if made.surface else None
    sidecar = f"{job.name}_{target}.json"
    notes = made.notes if job.maps.periodic else (*made.notes, _SEAM)
    with staged(folder) as stage:
        for file, texture in made.textures.items():
            texture.write(stage / file)
        for file, content in made.documents.items():
            (stage / file).write_bytes(content)
        text = json.dumps(
            _sidecar(made, job, target, off, notes), indent=2, allow_nan=False, default=str
        )
        (stage / sidecar).write_text(text + "\n")
        files = tuple(sorted(file.name for file in stage.iterdir()))
    return Exported(folder, files, off, notes)


def _sidecar(
    made: Export, job: ExportJob, target: str, off: Residual | None, notes: Sequence[str]
) -> dict[str, Any]:
    """NAME_TARGET.json; the module tells its keys."""
    width, height = job.maps.size
    across, down = (side * job.unit_length for side in job.extent)
    return {
        "format": FORMAT,
        "version": VERSION,
        "matcap": MAKER_VERSION,
        "target": target,
        "name": job.name,
        "width": width,
        "height": height,
        "unit": job.unit,
        "tile": [across, down],
        "periodic": job.maps.periodic,
        "seam": round(seam_ratio(job.maps), 3),
        "files": {
            file: {
                "colour_space": texture.colour_space,
                "depth": texture.depth,
                "meaning": texture.meaning,
            }
            for file, texture in made.textures.items()
        },
        "documents": sorted(made.documents),
        "residual": None if off is None else {"mean": off.mean, "worst": off.worst},
        "notes": list(notes),
        **made.facts,
        "provenance": dict(job.provenance),
    }
