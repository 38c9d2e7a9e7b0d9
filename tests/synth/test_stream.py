"""Rectangles of any size to files: whatever the way there, the same bytes."""

import json
import pickle
import signal
import subprocess
import sys
import time
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np
import OpenImageIO as oiio
import pytest
import torch

from matcap.brdf.folder import MapSetInfo, read_mapset
from matcap.errors import MatcapError
from matcap.field.blocks import Grid
from matcap.field.field import Field, read_source
from matcap.field.plane import Rectangle
from matcap.synth import workers
from matcap.synth.fields import OpenedField
from matcap.synth.jobs import rendered
from matcap.synth.request import SynthRequest, Work
from matcap.synth.stream import write_field

# Blocks much smaller than the shipped ones: many of them take little time.
SMALL = Grid(128, 64)
# Across a corner of the grid, and of no tile's edge.
ODD = Rectangle(512 - 70, -256 - 21, 200, 90)


def request(material, area=ODD, seed=5, period=None, **stored):
    """A request, and its field with small blocks."""
    source = replace(material.generator.source(seed, period), grid=SMALL)
    field = OpenedField(source, MapSetInfo("m", seed, (area.x, area.y)))
    return SynthRequest(Path("m.matcap"), area, seed, **stored), field


def contents(folder):
    """A digest of every file: where bytes differ, pytest would compare them for hours."""
    return {
        file.name: sha256(file.read_bytes()).hexdigest()
        for file in folder.iterdir()
        if file.is_file()
    }


def pixels(path):
    return oiio.ImageBuf(str(path)).get_pixels("float")


@pytest.mark.parametrize("area", [ODD, Rectangle(-64, 2**40 - 200, 700, 64)])
def test_files_hold_the_field(material, tmp_path, area):
    write_field(*request(material, area), tmp_path)
    maps, _ = read_mapset(tmp_path)
    field = read_source(request(material)[1].source, area, 1)
    assert torch.equal(maps.height, field.height)
    for kind in ("diffuse", "specular", "roughness"):
        assert torch.equal(getattr(maps, kind), getattr(field, kind).half().float())


def test_normals_look_beyond_blocks_and_beyond_the_rectangle(material, tmp_path):
    write_field(*request(material), tmp_path)
    wide = Field(material, 5).read(ODD.x - 1, ODD.y - 1, ODD.width + 2, ODD.height + 2)
    expected = wide.normal[:, 1:-1, 1:-1].permute(1, 2, 0).numpy()
    assert np.abs(pixels(tmp_path / "m_normal.exr") - expected).max() < 1e-3
    write_field(*request(material, normal="dx"), tmp_path / "dx")
    assert np.array_equal(
        pixels(tmp_path / "dx/m_normal.exr"), pixels(tmp_path / "m_normal.exr") * [1, -1, 1]
    )


def test_workers_change_no_byte(material, tmp_path):
    """Threads for few blocks, processes for more: both beside a single thread."""
    area = Rectangle(40, 7, 2 * 128, 26 * 64)
    lines = []
    write_field(*request(material, area), tmp_path / "1", Work(1, progress=lines.append))
    assert lines[-1].fraction == 1.0
    assert [now.fraction for now in lines] == sorted(now.fraction for now in lines)
    write_field(*request(material, area), tmp_path / "2", Work(2))
    assert contents(tmp_path / "1") == contents(tmp_path / "2")
    write_field(*request(material), tmp_path / "3", Work(3))
    write_field(*request(material), tmp_path / "4", Work(1))
    assert contents(tmp_path / "3") == contents(tmp_path / "4")


def test_a_killed_run_is_resumed_to_the_same_bytes(material, tmp_path, monkeypatch):
    """SIGKILL: nobody tidies up, and the worker processes must not outlive it."""
    area = Rectangle(0, 0, 12 * 128, 16 * 64)  # wider than the preview, which is made again
    (tmp_path / "request").write_bytes(pickle.dumps(request(material, area)))
    program = (
        "import pickle; from matcap.synth.stream import Work, write_field\n"
        "if __name__ == '__main__':\n"
        "    write_field(*pickle.load(open('request', 'rb')), 'cut', Work(2))\n"
    )
    (tmp_path / "program.py").write_text(program)
    run = subprocess.Popen([sys.executable, "program.py"], cwd=tmp_path)
    part = tmp_path / "cut/.m.matcap-part/m_height.exr"
    deadline = time.monotonic() + 120
    while not (part.exists() and part.stat().st_size > 300_000) and run.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.005)
    run.send_signal(signal.SIGKILL)
    assert run.wait() == -signal.SIGKILL
    assert [file.name for file in (tmp_path / "cut").iterdir()] == [".m.matcap-part"]
    lines, computed = [], []
    monkeypatch.setattr(workers, "rendered", lambda *a: computed.append(a) or rendered(*a))
    again = Work(resume=True, progress=lines.append)
    write_field(*request(material, area), tmp_path / "cut", again)
    assert 0 < len(computed) < len(lines)
    write_field(*request(material, area), tmp_path / "whole")
    assert contents(tmp_path / "cut") == contents(tmp_path / "whole")


def test_two_runs_in_one_place_do_not_mix(material, tmp_path):
    def again(_now):
        with pytest.raises(MatcapError, match="another matcap is writing"):
            write_field(*request(material, seed=6), tmp_path)

    write_field(*request(material), tmp_path, Work(progress=again))
    assert json.loads((tmp_path / "m.json").read_text())["seed"] == 5


def test_values_that_are_not_finite_are_refused_and_leave_nothing(material, tmp_path):
    source = material.generator.source(0)
    broken = replace(source, texel_size=float("nan"))
    with pytest.raises(MatcapError, match="not finite"):
        asked = SynthRequest(Path("m.matcap"), ODD)
        write_field(asked, OpenedField(broken, MapSetInfo("m")), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_what_an_older_set_had_and_a_newer_has_not_goes(material, tmp_path):
    (tmp_path / "m_of_mine.txt").touch()
    write_field(*request(material, png=True), tmp_path)
    write_field(*request(material, udim=(2, 1)), tmp_path)
    assert len(list(tmp_path.iterdir())) == 3 + 2 * 5


def test_pngs_hold_what_the_exrs_hold(material, tmp_path):
    write_field(*request(material, png=True, udim=(2, 1)), tmp_path)
    document = json.loads((tmp_path / "m.json").read_text())["png"]
    ends = []
    for number in (1001, 1002):
        height = cv2.imread(str(tmp_path / f"m_height.{number}.png"), cv2.IMREAD_UNCHANGED) / 65535
        ends += [height.min(), height.max()]
        found = (height - document["height_midlevel"]) * document["height_scale"]
        expected = pixels(tmp_path / f"m_height.{number}.exr")[..., 0]
        assert np.abs(found - expected).max() <= 0.51 / 65535 * document["height_scale"]
        normal = cv2.imread(str(tmp_path / f"m_normal.{number}.png"), cv2.IMREAD_UNCHANGED)
        normal = normal[..., ::-1] / 65535 * 2 - 1
        assert np.abs(normal - pixels(tmp_path / f"m_normal.{number}.exr")).max() < 3e-5
    assert min(ends) == 0 and max(ends) == 1  # one range for the whole texture set


def test_smaller_levels_are_averages(material, tmp_path):
    period = (192, 96)
    area = Rectangle(0, 0, *period)
    write_field(*request(material, area, mipmap=True, period=period), tmp_path)
    source = oiio.ImageInput.open(str(tmp_path / "m_height.exr"))
    assert source.spec().getattribute("wrapmodes") == "periodic,periodic"
    larger = source.read_image(0, 0, 0, 1, "float")[..., 0]
    for level in range(1, 8):
        small = source.read_image(0, level, 0, 1, "float")[..., 0]
        assert small.shape == tuple(max(side >> level, 1) for side in (96, 192))
        assert small.mean() == pytest.approx(larger.mean(), abs=1e-6 * float(np.abs(larger).max()))
        if larger.shape == (2 * small.shape[0], 2 * small.shape[1]):
            boxes = larger.reshape(small.shape[0], 2, small.shape[1], 2).mean(axis=(1, 3))
            assert np.allclose(small, boxes, atol=1e-6 * np.abs(larger).max())
        larger = small
    source.close()
    normal = oiio.ImageInput.open(str(tmp_path / "m_normal.exr"))
    small = normal.read_image(0, 2, 0, 3, "float")
    assert np.abs(np.linalg.norm(small, axis=2) - 1).max() < 2e-3
    normal.close()
    # A resumed run of levels ends with the same bytes too.
    write_field(*request(material, area, mipmap=True, period=period), tmp_path / "again", Work(3))
    first, again = contents(tmp_path), contents(tmp_path / "again")
    assert all(again[name] == digest for name, digest in first.items() if name.endswith(".exr"))
