"""Synthesis to files."""

import json
import os
import pickle
import platform
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
from matcap.errors import MatcapError, UsageError
from matcap.field.field import Field, find_device, read_source, repeatable
from matcap.field.plane import Grid, Rectangle
from matcap.files import process
from matcap.files.names import Progress
from matcap.space.tuned import DecoderSource
from matcap.synth import stream
from matcap.synth.plan import OpenedField
from matcap.synth.request import SynthRequest, Work
from matcap.synth.stream import rendered, synthesise, write_field

# Rectangles of any size to files: whatever the way there, the same bytes.


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
    files = (file for file in folder.iterdir() if file.is_file())
    return {file.name: sha256(file.read_bytes()).hexdigest() for file in files}


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
    flipped = pixels(tmp_path / "dx/m_normal.exr") * [1, -1, 1]
    assert np.array_equal(flipped, pixels(tmp_path / "m_normal.exr"))


def test_workers_change_no_byte(material, tmp_path):
    """Threads for few blocks, processes for more: both beside a single thread."""
    area = Rectangle(40, 7, 2 * 128, stream._FEW // 2 * 64)  # on three columns of blocks
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
    monkeypatch.setattr(stream, "rendered", lambda *a: computed.append(a) or rendered(*a))
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
    broken = OpenedField(replace(source, texel_size=float("nan")), MapSetInfo("m"))
    with pytest.raises(MatcapError, match="not finite"):
        write_field(SynthRequest(Path("m.matcap"), ODD), broken, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_files_of_an_older_set_are_removed(material, tmp_path):
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


# Python can do what `matcap synth` does.


def test_a_request_is_written_as_the_field_reads(material, tmp_path):
    asked = SynthRequest(material, Rectangle(-20, 7, 48, 32), seed=3)
    maps, document = read_mapset(synthesise(asked, tmp_path / "set"))
    torch.testing.assert_close(maps.height, material.maps(48, 32, seed=3, x=-20, y=7).height)
    assert (document["name"], document["seed"]) == (material.name, 3)
    assert (document["x"], document["y"]) == (-20, 7)


@pytest.mark.parametrize(
    ("tile", "period"), [("both", [64, 32]), ("x", [64, None]), ("y", [None, 32])]
)
def test_the_document_of_a_tile_states_its_period(material, tmp_path, tile, period):
    asked = SynthRequest(material, Rectangle(0, 0, 32, 32), name="two", udim=(2, 1), tile=tile)
    document = json.loads(synthesise(asked, tmp_path / "set").read_text())
    assert document["name"] == "two" and document["period"] == period


def test_a_seed_out_of_range_is_a_usage_error(material, tmp_path):
    with pytest.raises(UsageError, match="out of range"):
        synthesise(SynthRequest(material, Rectangle(0, 0, 8, 8), seed=2**63), tmp_path / "set")
    assert list(tmp_path.iterdir()) == []


# Large buffers are used again, in threads too: fresh pages can cost as much as the computing.

TESTS = Path(__file__).parents[1]
PROGRAM = """
import resource, sys
from matcap.space.decoder import DecoderConfig
from matcap.space.random_field import Rectangle
from matcap.files.threads import single_threaded
from matcap.files.process import keep_memory
from matcap.space.tuned import TunedDecoder

if sys.argv[1] == "kept":
    keep_memory()
sys.path.insert(0, sys.argv[2])
from materials import a_material

config = DecoderConfig(2, (32, 32, 32, 32, 32), (1, 1))
source = a_material(config=config).part(TunedDecoder).source(0)
faults = []
with single_threaded(1) as pool:
    for _ in range(3):
        pool.submit(source.maps, Rectangle(0, 0, 256, 256)).result()
        faults.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt)
print(faults[-1] - faults[1])
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the settings are glibc's")
def test_the_buffers_of_one_block_serve_the_next():
    fetched = {}
    for name in ("as it comes", "kept"):
        command = [sys.executable, "-c", PROGRAM, name, str(TESTS)]
        run = subprocess.run(command, capture_output=True, check=True, text=True)
        fetched[name] = int(run.stdout)
    assert fetched["kept"] < 0.1 * fetched["as it comes"]


# One device or the other: chosen, refused, never mixed. What needs CUDA is skipped without it.

CONVOLUTION = torch.backends.cudnn.conv
needs_cuda = pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA device")


class OnCuda(DecoderSource):
    """Says that it is on CUDA, for what only asks."""

    device = torch.device("cuda")


def claimed(asked):
    """A request whose source says so."""
    request, field = asked
    return request, replace(field, source=OnCuda(**vars(field.source)))


@pytest.mark.parametrize(
    ("name", "there", "found"),
    [("auto", True, "cuda"), ("auto", False, "cpu"), ("cpu", True, "cpu"), ("cuda", True, "cuda")],
)
def test_the_device_is_what_was_asked_for_and_is_there(monkeypatch, name, there, found):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: there)
    assert find_device(name) == torch.device(found)


def test_cuda_that_is_not_there_is_refused(material, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(UsageError, match="sees no CUDA device; use cpu, or"):
        Field(material, device="cuda")
    assert Field(material, device="auto").source.device.type == "cpu"


def test_nothing_of_a_block_is_left_on_the_processor(wavy):
    """A device without memory, in place of CUDA, refuses operands that lie elsewhere."""
    maps = wavy.generator.source(1, device=torch.device("meta")).maps(Rectangle(0, 0, 64, 32))
    assert (maps.device.type, maps.shape, maps.dtype) == ("meta", (6, 34, 66), torch.float32)


@pytest.mark.parametrize("everything", ["none", "tf32"])
def test_repeatable_makes_convolutions_exact_and_restores_settings(monkeypatch, everything):
    """Also where the process wants TF32 everywhere."""
    monkeypatch.setattr(torch.backends, "fp32_precision", everything)
    before = CONVOLUTION.fp32_precision
    with pytest.raises(KeyError), repeatable(torch.device("cuda")):
        assert CONVOLUTION.fp32_precision == "ieee" and torch.backends.cudnn.deterministic
        raise KeyError
    assert CONVOLUTION.fp32_precision == before == "tf32" and not torch.backends.cudnn.deterministic
    with repeatable(torch.device("cpu")):
        assert CONVOLUTION.fp32_precision == before


def test_a_run_is_not_resumed_on_another_device(material, tmp_path):
    def full(_now):
        raise OSError(28, "No space left on device")

    with pytest.raises(MatcapError, match="full"):
        write_field(*request(material), tmp_path, Work(progress=full))
    with pytest.raises(MatcapError, match="begun on cpu; cuda rounds differently; give --device"):
        write_field(*claimed(request(material)), tmp_path, Work(resume=True))
    # The refusal took nothing away.
    write_field(*request(material), tmp_path, Work(resume=True))
    write_field(*request(material), tmp_path / "whole")
    assert contents(tmp_path) == contents(tmp_path / "whole")


def test_a_cluster_is_not_sent_to_cuda(material, tmp_path):
    with pytest.raises(UsageError, match="CPUs"):
        write_field(*claimed(request(material)), tmp_path, Work(scheduler="tcp://127.0.0.1:9"))


@needs_cuda
def test_cuda_gives_the_processors_maps(wavy):
    area = (-200, 100, 700, 300)
    here, there = (Field(wavy, 3, device=name).read(*area) for name in ("cpu", "cuda"))
    assert there.height.device.type == "cpu"
    for kind in ("diffuse", "specular", "roughness"):
        assert float((getattr(here, kind) - getattr(there, kind)).abs().max()) < 1e-4
    assert float((here.height - there.height).abs().max()) < 1e-4 * float(here.height.std())


@needs_cuda
def test_cuda_repeats_its_bits_whatever_is_asked_for(wavy):
    field = Field(wavy, 3, device="cuda")
    whole = field.read(-200, 100, 700, 300, workers=3).stacked()
    part = field.read(-50, 190, 170, 100, workers=1).stacked()
    assert torch.equal(part, whole[:, 90:190, 150:320])


@needs_cuda
def test_workers_change_no_byte_on_cuda(material, tmp_path):
    asked, field = request(material, ODD)
    source = replace(field.source, decoder=field.source.decoder.to(torch.device("cuda")))
    for count in (1, 3):
        write_field(asked, replace(field, source=source), tmp_path / str(count), Work(count))
    assert contents(tmp_path / "1") == contents(tmp_path / "3")


@pytest.mark.parametrize("stated", [{}, {"THP_MEM_ALLOC_ENABLE": "0"}])
def test_large_tensors_are_aligned_to_huge_pages_unless_the_user_says_otherwise(stated):
    """PyTorch reads it once, so a process of its own asks."""
    code = (
        "import os; from matcap.files.process import keep_memory; keep_memory();"
        "print(os.environ['THP_MEM_ALLOC_ENABLE'])"
    )
    others = {name: value for name, value in os.environ.items() if not name.startswith("THP_")}
    done = subprocess.run([sys.executable, "-c", code], env=others | stated, capture_output=True)
    assert done.stdout.split() == [stated.get("THP_MEM_ALLOC_ENABLE", "1").encode()]


def test_memory_is_returned_where_a_stage_begins(monkeypatch):
    seen, returned = [], []
    monkeypatch.setattr(process, "return_memory", lambda: returned.append(len(seen)))
    report = process.returning_memory(seen.append)
    steps = [Progress(stage, 0.1) for stage in ("network", "network", "inpaint", "network")]
    for step in steps:
        report(step)
    assert seen == steps and returned == [0, 2]
