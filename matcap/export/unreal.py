"""A script that imports the textures into Unreal and builds the material.

The script is the same for every material (scripts/unreal_import.py) and reads the sidecar
NAME_unreal.json.
"""

from __future__ import annotations

from importlib.resources import files as resources
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matcap.export.job import ExportJob
    from matcap.export.presets import EngineModel


def unreal_import(job: ExportJob, files: dict[str, str], model: EngineModel) -> dict[str, str]:
    """T_NAME_import.py by file name."""
    del files, model  # in the sidecar
    script = resources("matcap.export.scripts").joinpath("unreal_import.py").read_text()
    return {f"T_{job.name}_import.py": script}
