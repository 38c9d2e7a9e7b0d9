"""A dask cluster gives the same bytes, and losing a worker changes none."""

import filecmp
import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from matcap.brdf.folder import MapSetInfo
from matcap.errors import MatcapError
from matcap.field.plane import Grid, Rectangle
from matcap.synth.plan import OpenedField
from matcap.synth.request import SynthRequest, Work
from matcap.synth.stream import write_field

distributed = pytest.importorskip("distributed", reason="needs the extra `cluster`")

pytestmark = pytest.mark.filterwarnings("ignore")  # dask's own, on a busy machine


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        silence_logs=50,
        worker_class=distributed.Nanny,
    ) as running:
        yield running


def test_a_worker_is_killed_half_way(material, tmp_path, cluster):
    area = Rectangle(0, 0, 5 * 128, 8 * 64)
    source = replace(material.generator.source(2), grid=Grid(128, 64))
    request = SynthRequest(Path("m"), area), OpenedField(source, MapSetInfo("m", 2))
    killed = []

    def kill(now):
        if not killed and now.fraction >= 0.5:
            pid = next(iter(cluster.workers.values())).pid
            os.kill(pid, signal.SIGKILL)
            killed.append(pid)

    work = Work(scheduler=cluster.scheduler_address, progress=kill)
    write_field(*request, tmp_path / "cluster", work)
    assert killed
    write_field(*request, tmp_path / "here")
    for file in (tmp_path / "here").iterdir():
        assert filecmp.cmp(file, tmp_path / "cluster" / file.name, shallow=False)


def test_nobody_answers(material, tmp_path, monkeypatch):
    monkeypatch.setattr("matcap.files.process._PATIENCE", 0.5)
    field = OpenedField(material.generator.source(2), MapSetInfo("m", 2))
    request = SynthRequest(Path("m"), Rectangle(0, 0, 8, 8)), field
    with pytest.raises(MatcapError, match="no dask scheduler answers"):
        write_field(*request, tmp_path / "out", Work(scheduler="tcp://127.0.0.1:9"))
    assert list(tmp_path.iterdir()) == []
