"""Time against accuracy of relighting: what is left out stays within its tolerance."""

import pytest

from matcap_lab.bench.relight import (
    EVERYTHING,
    MEGAPIXEL,
    TOLERANCE,
    TOLERANCES,
    plan_experiment,
    tolerance_experiment,
)
from matcap_lab.experiment.page import section
from matcap_lab.experiment.runner import run

SCENE = """
[surface]
displacement = 0.0
[[light]]
type = "point"
position = [0.0, 1.0, 2.0]
intensity = [6.0, 6.0, 6.0]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene")
    (folder / "lamp.toml").write_text(SCENE)
    return folder


@pytest.fixture(scope="module")
def measured(folder):
    experiment = tolerance_experiment([folder / "lamp.toml"], width=16, texels=32, repeats=1)
    return run(experiment, folder / "tolerances.csv")


def test_no_tolerance_is_exceeded_and_all_effects_are_exact(measured):
    steps = {row.configuration: row.number("steps") for row in measured}
    for most in TOLERANCES:
        assert steps[f"{most:g} steps"] <= most
    assert steps[EVERYTHING] == pytest.approx(0.0, abs=1e-4)
    assert steps["diffuse alone"] > 0.5
    assert all(row.number("seconds") > 0.0 and row.subject == "lamp" for row in measured)


def test_its_page_and_picture_are_of_the_table(measured, folder):
    pytest.importorskip("matplotlib", reason="needs the extra `bench`")
    result = section(folder / "tolerances.csv", TOLERANCE, folder / "page.md")
    assert sum(line.startswith("| * | ") for line in result) >= 1
    assert sum(" | lamp" in line or "steps | " in line for line in result) >= len(TOLERANCES)
    assert (folder / "tolerances.png").stat().st_size > 1000


def test_a_megapixel_has_no_other_effects_than_its_plan(folder):
    experiment = plan_experiment([folder / "lamp.toml"], repeats=1)
    assert experiment.skips(MEGAPIXEL, EVERYTHING) and not experiment.skips("lamp", EVERYTHING)
    lit = experiment.subjects["lamp"]()
    found = experiment.configurations["plan"].run(lit, 0)
    assert found["effects"] >= 1.0 and found["seconds"] > 0.0
