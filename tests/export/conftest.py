"""Map sets to write."""

from functools import cache

import pytest
from exported import MATERIALS
from metals import metals
from random_maps import maps  # noqa: F401
from simulated.materials import realise

from matcap.brdf.maps import MapSet
from matcap.export.job import ExportJob
from matcap.export.targets import write_export


@pytest.fixture(scope="session")
def made() -> dict[str, MapSet]:
    """Small pieces of procedural materials, and of metals, by name."""
    return metals() | {
        name: realise(name, 48, 32, 1, 2.0 / 48).map(lambda map_: map_.float())
        for name in MATERIALS
    }


@pytest.fixture(scope="session")
def written(made, tmp_path_factory):
    """Folder and report of a material's export, made once: tests that change files copy them."""

    @cache
    def of(target, name, millimetres=None):
        folder = tmp_path_factory.mktemp(target) / "out"
        return folder, write_export(ExportJob(made[name], name, millimetres), target, folder)

    return of
