"""Every command of docs/guide/export.md runs and leaves the files that the page names."""

import json
import re
import shlex
from pathlib import Path

import pytest

from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap.cli.main import main
from matcap.export.engines import ENGINES
from matcap.export.libraries import LIBRARIES

PAGE = (Path(__file__).parents[2] / "docs" / "guide" / "export.md").read_text(encoding="utf-8")
SHELL = "".join(re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)).splitlines()
# Of a map set; what needs a material (--udim) is tried in tests/cli.
EXPORTS = [line for line in SHELL if line.startswith("matcap export") and "--udim" not in line]


LEATHER = MapSetInfo("leather", provenance={"made": "up"})


@pytest.fixture
def captured(tmp_path, monkeypatch, made):
    """What a capture leaves, but for its size."""
    write_mapset(made["leather"], tmp_path / "out" / "leather", LEATHER)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("line", EXPORTS)
def test_commands_run(captured, line):
    assert main(shlex.split(line)[1:]) == 0


ENDS = {"materialx": ".mtlx", "gltf": ".glb", "usd": ".usd", "blender": ".py", "mitsuba": ".xml"}


@pytest.mark.parametrize("target", ENDS)
def test_files_are_called_as_the_page_says_and_residuals_are_told(captured, target, capsys):
    assert any(f"--to {target}" in line for line in EXPORTS)
    assert main(["export", "out/leather", "--to", target]) == 0
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith(f"wrote leather_{target} (")
    assert "residual" in said.err
    there = {file.name for file in (captured / f"leather_{target}").iterdir()}
    named = re.findall(r"`(leather[\w.]*\.(?:mtlx|glb|usd[az]|py|xml))`", PAGE)
    mine = {name for name in named if ENDS[target] in name}
    assert mine and mine <= there
    sidecar = json.loads((captured / f"leather_{target}/leather_{target}.json").read_text())
    assert sidecar["provenance"] == {"made": "up"}


@pytest.mark.parametrize("preset", [*LIBRARIES, *ENGINES])
def test_files_of_presets_are_called_as_the_table_says(captured, preset):
    (row,) = re.findall(rf"^\| `{preset}` \| (.*?) \|", PAGE, re.MULTILINE)
    forms = ENGINES.get(preset, {None: None})
    for form in forms:
        asked = ["--workflow", form] if form else []
        assert main(["export", "out/leather", "--to", preset, *asked, "-q", "--overwrite"]) == 0
    there = " ".join(file.name for file in (captured / f"leather_{preset}").iterdir())
    for part in re.findall(r"`([^`]+)`", row):
        wanted = re.sub("1k", "48", part, flags=re.IGNORECASE)  # 48 texels here, 1024 there
        assert wanted.split(".")[0] in there
