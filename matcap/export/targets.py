"""Every target that maps can be exported to, and the one function that writes them.

A target has one form or two: its metallic workflow, and its specular one. The form that comes
nearest is written, unless another is asked for. What a target's folder holds, `NAME_TARGET.json`
tells.

Keys:
    format: "matcap export".
    version: 2.
    matcap: version of the program that wrote it.
    target: or preset.
    workflow: the form that was written, "metallic" or "specular"; null where there is only one.
    name: of the map set.
    width: texels.
    height: texels.
    unit: what lengths are told in, "mm" or "plane unit".
    tile: (width, height) of the piece in that unit.
    texel: a texel's side in that unit.
    height_code: where the target stores heights, `scale`, `midlevel` and `unit`:
        height = (value - midlevel) * scale.
    periodic: whether it repeats without a seam.
    udim: (columns, rows) of a texture set, whose file names say `<UDIM>` for 1001 and on, left
        bottom first; null where there is none. `width` and `height` are a tile's, `tile` the set's.
    seam: step across the border over steps inside, about 1 without a seam.
    files: for each texture its `colour_space`, `depth` and `meaning`.
    documents: names of the other files.
    residual: `mean` and `worst` share of light that differs from matcap's; null for plain maps.
    residuals: the same of every form and every way in which the target's programs read the files.
    occlusion: how ambient occlusion was found: `azimuths`, `reach`, `cavity_reach`, their `unit`.
    notes: what must be known, a sentence each.
    textures: the file of each map, for scripts.
    provenance: how the material was made.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from matcap.brdf.seam import seam_ratio
from matcap.errors import UsageError
from matcap.export.blender import blender
from matcap.export.engines import ENGINES
from matcap.export.gltf import gltf_metallic, gltf_specular
from matcap.export.job import ExportJob, known_scale
from matcap.export.libraries import LIBRARIES
from matcap.export.materialx import materialx
from matcap.export.mitsuba import mitsuba
from matcap.export.names import known
from matcap.export.presets import PresetOptions, pack
from matcap.export.reach import material_reach
from matcap.export.surface import Residual, residuals
from matcap.export.texture_file import TOKEN, WRITERS, TextureFile
from matcap.export.textures import Export, Workflow
from matcap.export.udim import FIRST
from matcap.export.usd import usd_metallic, usd_specular
from matcap.files.maker import MAKER_VERSION
from matcap.files.staging import staged

FORMAT = "matcap export"
VERSION = 2

_SEAM = (
    "These maps do not repeat: there is a seam where they meet themselves. Export the material, "
    "at sides that are multiples of 16, for maps without one."
)

# All maps twice, in 32-bit floats: no target takes more.
_TEXEL_BYTES = 2 * 4 * (3 + 1 + 1 + 1 + 3)

# Programs that find no tiles by their numbers.
_NO_TILES = ("gltf", "mitsuba", "godot")

# The forms of a target by workflow; one without a name where there is no choice.
Forms = Mapping[Workflow | None, Callable[[ExportJob], Export]]

# Targets with a document of their own.
DOCUMENTS: dict[str, Forms] = {
    "materialx": {None: materialx},
    "usd": {"specular": usd_specular, "metallic": usd_metallic},
    "gltf": {"specular": gltf_specular, "metallic": gltf_metallic},
    "blender": {None: blender},
    "mitsuba": {None: mitsuba},
}
# Presets and, where one has two forms, a name for each.
PRESETS: tuple[str, ...] = (
    *LIBRARIES,
    *ENGINES,
    *(f"{name}-{form}" for name, forms in ENGINES.items() if len(forms) > 1 for form in forms),
)


@dataclass(frozen=True)
class Exported:
    """What was written.

    Attributes:
        folder: where.
        files: names in it, sorted.
        residual: how far the target's light is from matcap's; None for plain maps.
        notes: what the user must know, a sentence each.
        workflow: the form that was written; None where there is only one.
        residuals: of every form and every way of reading it, by name.
    """

    folder: Path
    files: tuple[str, ...]
    residual: Residual | None
    notes: tuple[str, ...]
    workflow: Workflow | None = None
    residuals: Mapping[str, Residual] = field(default_factory=dict)


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
    from matcap.field.opened import open_tile

    found = open_tile(folder)
    place = folder if folder.is_dir() else folder.parent
    millimetres = known_scale(found.provenance)
    reach = material_reach(folder, found.name)
    job = ExportJob(found.maps, found.name, millimetres, provenance=found.provenance, reach=reach)
    return write_export(job, target, place / target)


def export_bytes(width: int, height: int) -> int:
    """Disk space that an export of this size takes at most."""
    return width * height * _TEXEL_BYTES + 1_000_000


def write_export(
    job: ExportJob,
    target: str,
    folder: Path,
    choice: PresetOptions | None = None,
    workflow: Workflow | None = None,
) -> Exported:
    """Write maps for a target, all files or none.

    Args:
        job: the maps and how to write them.
        target: a key of DOCUMENTS or one of PRESETS; "gltf" is the document.
        folder: made when missing; files of the same names are replaced.
        choice: for presets only.
        workflow: the form; the one that comes nearest by default.

    Raises:
        UsageError: no such target, or one that does not know the choice, the workflow or texture
            sets.
        MatcapError: values that are not finite, a full disk, an unwritable folder.
    """
    if target in DOCUMENTS:
        return _write(DOCUMENTS[target], job, target, folder, workflow)
    return write_preset(job, target, folder, choice, workflow)


def write_preset(
    job: ExportJob,
    preset: str,
    folder: Path,
    choice: PresetOptions | None = None,
    workflow: Workflow | None = None,
) -> Exported:
    """Write loose textures under a preset's names, all files or none.

    Raises:
        UsageError: no such preset, or a choice that does not fit it.
        MatcapError: as write_export.
    """
    return _write(preset_forms(preset, choice), job, preset, folder, workflow)


def preset_forms(name: str, choice: PresetOptions | None = None) -> Forms:
    """The forms of a preset; one of them where the name says which.

    Raises:
        UsageError: no such preset.
    """
    known(name, PRESETS, "--preset")
    if name in LIBRARIES:
        return {None: partial(pack, preset=LIBRARIES[name], choice=choice)}
    engine, forms = next(
        (engine, forms)
        for engine, forms in ENGINES.items()
        if name == engine or name.removeprefix(f"{engine}-") in forms
    )
    return {
        form: partial(pack, preset=preset, choice=choice)
        for form, preset in forms.items()
        if name in (engine, f"{engine}-{form}")
    }


def _write(
    forms: Forms, job: ExportJob, target: str, folder: Path, workflow: Workflow | None
) -> Exported:
    """Write the form that comes nearest, or the one asked for, and the sidecar NAME_TARGET.json."""
    if workflow is not None and workflow not in forms:
        names = [name for name in forms if name]
        raise UsageError(
            f"{target} has no {workflow} workflow",
            where="--workflow",
            remedy=f"give {' or '.join(names)}" if names else "leave it out",
        )
    if job.tiles is not None and target in _NO_TILES:
        raise UsageError(
            f"{target} knows no texture sets", where="--udim", remedy="leave it out, or give --size"
        )
    # Every form is asked what comes of it; only the chosen one makes its files.
    made = {form: make(job) for form, make in forms.items()}
    found = {form: residuals(job, export.surfaces) for form, export in made.items()}
    first = {form: next(iter(one.values()), None) for form, one in found.items()}
    chosen = workflow or min(first, key=lambda form: _mean(first[form]))
    export, off = made[chosen], first[chosen]
    told = {name: one for per_form in found.values() for name, one in per_form.items()}
    sidecar = f"{job.name}_{target}.json"
    notes = export.notes if job.repeats else (*export.notes, _SEAM)
    with staged(folder) as stage:
        _write_textures(export.textures, job, stage, FIRST)
        for number, tile in job.others():
            _write_textures(export.textures, tile, stage, number)
        for file, content in export.documents.items():
            (stage / file).write_bytes(content(stage))
        about = _sidecar(export, job, target, off, notes) | {
            "workflow": chosen,
            "residuals": {
                name: {"mean": one.mean, "worst": one.worst} for name, one in told.items()
            },
        }
        text = json.dumps(about, indent=2, allow_nan=False, default=str)
        (stage / sidecar).write_text(text + "\n")
        files = tuple(sorted(file.name for file in stage.iterdir()))
    return Exported(folder, files, off, notes, chosen, told)


def _write_textures(
    textures: Mapping[str, TextureFile], job: ExportJob, stage: Path, number: int
) -> None:
    """All textures of a job; where it is a tile of a texture set, of that number."""

    def write(named: tuple[str, TextureFile]) -> None:
        name, texture = named
        texture.write(stage / name.replace(TOKEN, str(number)), job)

    with ThreadPoolExecutor(WRITERS) as pool:
        list(pool.map(write, textures.items()))


def _mean(off: Residual | None) -> float:
    return 0.0 if off is None else off.mean


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
        "texel": job.maps.texel_size * job.unit_length,
        "periodic": job.repeats,
        "udim": job.grid,
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
