"""A script that builds the material in Blender, from textures beside it.

The script is the same for every material (scripts/blender_material.py); it reads the sidecar
NAME_blender.json. In Cycles it has matcap's own reflectance; Eevee approximates it. Blender counts
metres, and so do its plane and its displacement.
"""

from __future__ import annotations

from importlib.resources import files as resources

from matcap.export.job import ExportJob
from matcap.export.textures import Export, Standard


def blender(job: ExportJob) -> Export:
    """NAME_blender.py beside its textures."""
    textures = Standard.of(job)
    files = textures.files(job.name)
    script = resources("matcap.export.scripts").joinpath("blender_material.py").read_bytes()
    kinds = ("diffuse", "specular", "roughness", "normal_gl", "height")
    facts = {
        "textures": dict(zip(kinds, files, strict=True)),
        "height_code": {"scale": job.unit_length, "midlevel": 0.0, "unit": job.unit},
    }
    return Export(
        dict(files),
        {f"{job.name}_blender.py": lambda _: script},
        {"exact": textures.surface},
        ("needs Blender 4.3 or later, and Cycles for the exact reflectance", *job.size_notes()),
        facts,
    )
