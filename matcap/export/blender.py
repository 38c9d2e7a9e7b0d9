"""Export to Blender: textures, and a script that builds the material from them.

The script is the same for every material (scripts/blender_material.py) and reads the sidecar
NAME_blender.json. In Cycles the material has matcap's reflectance; Eevee approximates it. Plane and
displacement are in metres, Blender's unit.
"""

from __future__ import annotations

from importlib.resources import files as resources

from matcap.export.job import ExportJob
from matcap.export.textures import Export, Standard


def blender(job: ExportJob) -> Export:
    """NAME_blender.py and its textures."""
    textures = Standard.of(job)
    files = textures.files(job.name)
    script = resources("matcap.export.scripts").joinpath("blender_material.py").read_bytes()
    kinds = ("diffuse", "specular", "roughness", "normal_gl", "height")
    entries = {
        "textures": dict(zip(kinds, files, strict=True)),
        "height_code": {"scale": job.unit_length, "midlevel": 0.0, "unit": job.unit},
    }
    return Export(
        dict(files),
        {f"{job.name}_blender.py": lambda _: script},
        {"exact": textures.surface},
        ("needs Blender 4.3 or later, and Cycles for the exact reflectance", *job.size_notes()),
        entries,
    )
