"""Time against accuracy of relighting: what is left out stays within its tolerance."""

import pytest

from matcap.lab.bench.relight_tolerances import (
    TOLERANCES,
    measure_tolerances,
    tolerances_markdown,
    write_tolerances,
)
from matcap.lab.bench.table import read

SCENE = """
[surface]
displacement = 0.0
[[light]]
type = "point"
position = [0.0, 1.0, 2.0]
intensity = [6.0, 6.0, 6.0]
"""


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    file = tmp_path_factory.mktemp("scene") / "lamp.toml"
    file.write_text(SCENE)
    return measure_tolerances([file], width=16, texels=32, repeats=1)


def test_no_tolerance_is_exceeded_and_all_effects_are_exact(measured):
    errors = {one.point: one.error for one in measured}
    for steps in TOLERANCES:
        assert errors[f"{steps:g} steps"] <= steps
    assert errors["all effects"] == pytest.approx(0.0, abs=1e-4)
    assert errors["diffuse alone"] > 0.5
    assert all(one.seconds > 0.0 and one.subject == "lamp" for one in measured)


def test_table_and_picture_are_written_and_told(measured, tmp_path):
    pytest.importorskip("matplotlib", reason="needs the extra `bench`")
    write_tolerances(measured, tmp_path)
    assert [one.point for one in read(tmp_path / "relight.csv")] == [o.point for o in measured]
    assert (tmp_path / "relight.png").stat().st_size > 1000
    told = tolerances_markdown(measured, "matcap bench relight --tolerances")
    assert "    matcap bench relight --tolerances\n" in told
    rows = [line for line in told.splitlines() if line.startswith("| ") and "scenes" not in line]
    assert len(rows) == len(measured)
    assert any(line.startswith("| * |") for line in rows)
