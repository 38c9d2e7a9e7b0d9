"""All targets of exports, and the function that writes them.

A target has one or two forms: metallic and specular workflow. Unless the user chooses one, the form
with the smaller residual is written. The sidecar `NAME_TARGET.json` describes the files.

Keys:
    format: "matcap export".
    version: 2.
    matcap: version of the program that wrote it.
    target: target or preset.
    workflow: the form that was written, "metallic" or "specular"; null for targets with one form.
    name: of the map set.
    width: texels.
    height: texels.
    unit: of lengths, "mm" or "plane unit".
    tile: (width, height) of the maps in that unit.
    texel: a texel's side in that unit.
    height_code: of integer or scaled heights, `scale`, `midlevel` and `unit`:
        height = (value - midlevel) * scale.
    periodic: whether the maps tile seamlessly.
    seam: step across the border over steps inside, about 1 without a seam.
    files: for each texture its `colour_space`, `depth` and `meaning`.
    documents: names of the other files.
    residual: difference of reflected light from matcap's, over matcap's: `mean`, and `worst` view
        and light; null for unconverted maps.
    residuals: the same for every form and every known reader of the files.
    occlusion: parameters of ambient occlusion: `azimuths`, `reach`, `cavity_reach`, their `unit`.
    notes: for users, a sentence each.
    textures: the file of each map, for scripts.
    metallic: conversion to the metallic workflow, "plain", "tinted" or "free"
        (matcap/export/workflows.py); only of a metallic workflow.
    provenance: how the material was made.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from matcap.brdf.edited import seam_ratio
from matcap.errors import UsageError
from matcap.export.gltf import gltf_metallic, gltf_specular
from matcap.export.job import ExportJob, known_scale, material_reach
from matcap.export.materialx import materialx
from matcap.export.mitsuba import blender, mitsuba
from matcap.export.options import Container, ExportOptions, NormalMaps, Workflow
from matcap.export.presets import PLAIN, PRESETS, pack
from matcap.export.shading import Residual, residuals
from matcap.export.texture_file import WRITERS
from matcap.export.textures import Export
from matcap.export.usd import usd_metallic, usd_specular
from matcap.field.opened import OpenedMaps, open_tile
from matcap.files.names import MAKER_VERSION, plain_name, sanitised_name
from matcap.files.output import Output, check_output
from matcap.files.settings import known

FORMAT = "matcap export"
VERSION = 2

_SEAM = (
    "These maps have a seam where they repeat. Export the material (.matcap) at sides that are "
    "multiples of 16 for seamless maps."
)

# Largest size of an export in bytes a texel: all maps twice, in 32-bit floats.
_TEXEL_BYTES = 2 * 4 * (3 + 1 + 1 + 1 + 3)

_FAR = 0.1  # mean residual above which a note warns of it
_AS_NEAR = 0.02  # relative difference below which two residuals count as equal

# Exporters of a target by workflow; None where there is no choice.
Forms = Mapping[Workflow | None, Callable[[ExportJob], Export]]

# Targets with a document of their own, then those of textures alone.
DOCUMENTS: dict[str, Forms] = {
    "materialx": {None: materialx},
    "usd": {"specular": usd_specular, "metallic": usd_metallic},
    "gltf": {"specular": gltf_specular, "metallic": gltf_metallic},
    "blender": {None: blender},
    "mitsuba": {None: mitsuba},
}
TARGETS: dict[str, Forms] = DOCUMENTS | {
    name: {workflow: partial(pack, preset=preset) for workflow, preset in forms.items()}
    for name, forms in PRESETS.items()
}


@dataclass(frozen=True)
class Exported:
    """A written export."""

    folder: Path
    """The folder of its files."""
    files: tuple[str, ...]
    """File names, sorted."""
    workflow: Workflow | None
    """The form that was written; None for targets with one form."""
    residual: Residual | None
    """Difference of the target's reflected light from matcap's; None for unconverted maps."""
    residuals: Mapping[str, Residual]
    """Residuals of every form and every known reader, by name."""
    notes: tuple[str, ...]
    """Notes for the user, a sentence each."""

    def document(self) -> dict[str, Any]:
        """The export for JSON."""
        return asdict(self) | {"folder": str(self.folder)}


def check_targets(names: Sequence[str]) -> tuple[str, ...]:
    """Return names of targets without repetitions, in order.

    Raises:
        UsageError: an unknown name.
    """
    return tuple(dict.fromkeys(known(name, TARGETS, "--export") for name in names))


def engine_maps(container: Container, normal: NormalMaps) -> ExportOptions:
    """Options of `substance` for the textures that every engine reads: base colour, metallic,
    roughness, normal, height and ambient occlusion.
    """
    maps = ("base", "mask", "roughness", "normal", "height", "occlusion")
    return ExportOptions(maps=maps, container=container, normal=normal)


def export_mapset(
    folder: Path, target: str, options: ExportOptions | None = None, name: str = ""
) -> Exported:
    """Export the map set of a folder into a subfolder.

    Args:
        folder: holds one map set, or is its JSON document.
        target: of the export.
        options: of the export.
        name: of the subfolder; "" is the target's.

    Raises:
        UsageError: no such target.
        MatcapError: no map set, a full disk, an unwritable folder.
    """
    opened = open_tile(folder)
    place = folder if folder.is_dir() else folder.parent
    job = job_of(opened, folder, options or ExportOptions())
    return write_export(job, target, place / (name or target), overwrite=True)


def job_of(opened: OpenedMaps, path: Path, options: ExportOptions) -> ExportJob:
    """The job of a map set that was opened from `path`."""
    millimetres = options.unit or known_scale(opened.provenance)
    reach = material_reach(path, opened.name)
    return ExportJob(opened.maps, opened.name, millimetres, options, opened.provenance, reach)


def export_bytes(width: int, height: int) -> int:
    """Upper bound of the disk space of an export, in bytes."""
    return width * height * _TEXEL_BYTES + 1_000_000


def write_export(
    job: ExportJob,
    target: str,
    folder: Path,
    *,
    inputs: Sequence[Path] = (),
    overwrite: bool = False,
) -> Exported:
    """Write maps for a target, all files or none.

    The default workflow is presets.PLAIN's, else the one with the smaller residual.

    Args:
        folder: created if missing.
        inputs: files that were read, and must not be replaced.
        overwrite: replace existing files.

    Raises:
        UsageError: no such target; it has not the workflow asked for; it would replace a file in
            `inputs`.
        MatcapError: values that are not finite, a full disk, an unwritable folder, a file that
            exists.
    """
    forms = TARGETS[known(target, TARGETS, "--to")]
    # Other programs interpret $, @, <UDIM>, quotes and the like in file names.
    plain_name(job.name, what="the map set's name")
    job = replace(job, name=sanitised_name(job.name))
    form = _form(forms, target, job.options.workflow)
    # Compute the residual of every form; only the chosen one is written.
    made = {name: make(job) for name, make in forms.items()}
    errors = {name: residuals(job, export.surfaces) for name, export in made.items()}
    first = {name: next(iter(one.values()), None) for name, one in errors.items()}
    chosen = form or _nearest(first)
    named = {name: one for per_form in errors.values() for name, one in per_form.items()}
    about = _sidecar(made[chosen], job, target, first[chosen]) | {
        "workflow": chosen,
        "residuals": {name: asdict(one) for name, one in named.items()},
    }
    export, sidecar = made[chosen], sidecar_name(job.name, target)
    outputs = [folder / name for name in (*export.textures, *export.documents, sidecar)]
    check_output(outputs, inputs=inputs, overwrite=overwrite)
    files = _write(export, job, about, folder)
    return Exported(folder, files, chosen, first[chosen], named, tuple(about["notes"]))


def sidecar_name(name: str, target: str) -> str:
    """Name of the sidecar of an export."""
    return f"{sanitised_name(name)}_{target}.json"


def _form(forms: Forms, target: str, workflow: Workflow | None) -> Workflow | None:
    """The form that the user chose, else PLAIN's; None to compare residuals.

    Raises:
        UsageError: the target has not this workflow.
    """
    if workflow is not None and workflow not in forms:
        names = [name for name in forms if name]
        raise UsageError.at(
            "--workflow",
            f"{target} has no {workflow} workflow",
            f"give {' or '.join(names)}" if names else "leave it out",
        )
    return workflow or PLAIN.get(target)


def _write(
    export: Export, job: ExportJob, about: Mapping[str, Any], folder: Path
) -> tuple[str, ...]:
    """Write textures, documents and sidecar; returns the files' names, sorted."""
    with Output(folder).stage() as stage:
        with ThreadPoolExecutor(WRITERS) as pool:
            list(pool.map(lambda one: one[1].write(stage / one[0], job), export.textures.items()))
        for file, content in export.documents.items():
            (stage / file).write_bytes(content if isinstance(content, bytes) else content(stage))
        text = json.dumps(about, indent=2, allow_nan=False, default=str)
        (stage / sidecar_name(job.name, about["target"])).write_text(text + "\n")
        return tuple(sorted(file.name for file in stage.iterdir()))


def _nearest(errors: Mapping[Workflow | None, Residual | None]) -> Workflow | None:
    """The form with the smallest residual; of equal ones, the target's first."""
    means = {form: 0.0 if off is None else off.mean for form, off in errors.items()}
    most = (1.0 + _AS_NEAR) * min(means.values())
    return next(form for form, mean in means.items() if mean <= most)


def _sidecar(made: Export, job: ExportJob, target: str, off: Residual | None) -> dict[str, Any]:
    """The sidecar; the module's docstring lists its keys."""
    width, height = job.maps.size
    notes = list(made.notes)
    if off is not None and off.mean > _FAR:
        notes.append(f"{target} cannot represent this material: {off} differ from matcap's")
    return {
        "format": FORMAT,
        "version": VERSION,
        "matcap": MAKER_VERSION,
        "target": target,
        "name": job.name,
        "width": width,
        "height": height,
        "unit": job.unit,
        "tile": [side * job.unit_length for side in job.extent],
        "texel": job.maps.texel_size * job.unit_length,
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
        "residual": None if off is None else asdict(off),
        "notes": notes if job.maps.periodic else [*notes, _SEAM],
        **made.entries,
        "provenance": dict(job.provenance),
    }
