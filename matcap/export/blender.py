"""Export to Blender: textures, and a script that builds the material from them.

The script is the same for every material (scripts/blender_material.py) and reads the sidecar
NAME_blender.json. In Cycles the material has matcap's reflectance; Eevee approximates it. Plane and
displacement are in metres, Blender's unit.
"""

from __future__ import annotations

from functools import partial
from importlib.resources import files as resources

from matcap.export.job import ExportJob
from matcap.export.textures import (
    Export,
    by_file,
    file_names,
    height_entry,
    standard_surface,
    standard_textures,
)


def blender(job: ExportJob) -> Export:
    """NAME_blender.py and its textures."""
    textures = standard_textures(job)
    script = resources("matcap.export.scripts").joinpath("blender_material.py").read_bytes()
    return Export(
        by_file(job.name, textures),
        {f"{job.name}_blender.py": script},
        {"exact": partial(standard_surface, textures)},
        ("needs Blender 4.3 or later, and Cycles for the exact reflectance", *job.size_notes()),
        {"textures": file_names(job.name, textures)} | height_entry(job, 1.0, 0.0),
    )
