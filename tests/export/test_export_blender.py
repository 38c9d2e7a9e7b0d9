"""The script, by what it asks for; how Blender itself renders it is in docs/notes/exports.md."""

import json
import re

from matcap.export.targets import write_export
from matcap.export.textures import ExportJob


def test_the_script_finds_all_it_reads(tmp_path, made):
    import ast

    write_export(ExportJob(made["leather"], "leather", 85.0), "blender", tmp_path)
    code = (tmp_path / "leather_blender.py").read_text()
    ast.parse(code)
    sidecar = json.loads((tmp_path / "leather_blender.json").read_text())
    kinds = set(re.findall(r'texture\("(\w+)"', code)) | set(re.findall(r'files\["(\w+)"', code))
    assert kinds == set(sidecar["textures"])
    assert all((tmp_path / file).is_file() for file in sidecar["textures"].values())
    assert sidecar["height_code"] == {"scale": 85.0, "midlevel": 0.0, "unit": "mm"}
