"""The endless field and its sources."""

import hashlib
import random
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from types import SimpleNamespace

import pytest
import torch
from example.exemplars import blobs
from plain_decoder import decoded
from torus import WAVES, both, noisy

from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap.errors import MatcapError, UsageError
from matcap.example.example import Example
from matcap.field.field import Field
from matcap.field.material import Material
from matcap.field.opened import open_tile
from matcap.field.options import ReadOptions
from matcap.field.plane import Rectangle
from matcap.files.threads import at_once, compute_alone, one_thread, single_threaded, workers
from matcap.space.decoder import CODE_SIZE
from matcap.space.freeze import Drawing, reference_field
from matcap.space.random_field import Patch, noise_field, wave_field
from matcap.space.tuned import TunedDecoder
from matcap.statistics.lattice import Wave

# The field is one function of texel and seed, however it is read.


KINDS = ("noise", "waves", "drawing")


@cache
def of_kind(kind):
    drawing = Drawing(Example.of(blobs())) if kind == "drawing" else None
    return noisy(WAVES if kind == "waves" else (), drawing)


@pytest.fixture(params=KINDS)
def material(request):
    return of_kind(request.param)


@pytest.mark.parametrize(
    ("material", "origin"),
    [("noise", 2**40 - 900), ("waves", 2**31 - 300), ("drawing", 0)],
    indirect=["material"],
)
def test_rectangles_read_whole_in_parts_or_alone_are_bit_identical(material, origin):
    field = Field(material, seed=7)
    x, y = origin, -origin + 100
    whole = field.read(x, y, 600, 560, workers=2).stacked()
    cuts = [(0, 0, 64, 64), (500, 490, 64, 64), (130, 3, 470, 557), (599, 0, 1, 560)]
    random.Random(1).shuffle(cuts)
    for left, top, width, height in cuts:
        part = field.read(x + left, y + top, width, height, workers=1).stacked()
        assert torch.equal(part, whole[:, top : top + height, left : left + width])


def test_blocks_equal_the_tuned_network_on_the_whole_torus(material):
    """Against the decoder that is trained: circular padding, batch normalisation, no blocks."""
    found, expected = both(material)
    assert torch.allclose(found, expected, atol=2e-5)
    assert not torch.allclose(found, expected.roll(1, -1), atol=1e-2)


@pytest.mark.parametrize("period", [(160, 96), (160, None), (None, 96)])
def test_a_periodic_field_repeats_exactly_along_its_axes(material, period):
    maps = Field(material, 5, period).read(-40, 7, 320, 192).stacked()
    assert torch.equal(maps, maps.roll((period[1] or 0, period[0] or 0), (1, 2)))
    assert not torch.equal(maps, maps.roll((48, 80) if all(period) else (96, 160), (1, 2)))


@pytest.mark.usefixtures("two_threads")
def test_reading_works_in_inference_mode_and_leaves_the_thread_count(material):
    outside = Field(material, 2).read(0, 0, 40, 40, workers=2)
    threads = torch.get_num_threads()
    seen = []
    watcher = threading.Thread(target=lambda: seen.append(torch.get_num_threads()))
    with torch.inference_mode():
        inside = Field(material, 2).read(0, 0, 40, 40, workers=2)
    watcher.start()
    watcher.join()
    assert torch.equal(inside.stacked(), outside.stacked())
    assert torch.get_num_threads() == threads == 2 and seen == [threads]


def test_processes_give_the_same_field(tmp_path):
    files = [str(tmp_path / f"{kind}.matcap") for kind in KINDS]
    for kind, file in zip(KINDS, files, strict=True):
        of_kind(kind).save(file)
    program = (
        "import sys, hashlib, matcap\n"
        "for m in map(matcap.Material.load, sys.argv[1:]):\n"
        "    print(hashlib.sha256(m.maps(70, 50, seed=9).stacked().numpy().tobytes()).hexdigest())"
    )
    command = [sys.executable, "-c", program, *files]
    other = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    own = (of_kind(kind).maps(70, 50, seed=9).stacked().numpy().tobytes() for kind in KINDS)
    assert other == [hashlib.sha256(maps).hexdigest() for maps in own]


def test_seeds_give_different_fields(material):
    a, b = (material.maps(64, 64, seed=s).diffuse for s in (1, 2))
    assert (a - b).abs().max() > 0.01


def test_the_frozen_network_equals_the_tuned_one(material):
    tuned = material.part(TunedDecoder)
    decoder, code = tuned.decoder, tuned.code
    field = reference_field(decoder.config, tuned.waves, tuned.drawing)
    with torch.no_grad():
        own = decoder(field, code)
        frozen = decoder(field, code, tuned.moments)
        folded = decoded(tuned.folded, field)
    assert torch.allclose(own, frozen, atol=1e-4)
    inner = (..., slice(96, -96), slice(96, -96))
    assert torch.allclose(folded[inner], frozen[inner], atol=1e-4)


def test_a_saved_material_reads_back_equal(material, tmp_path):
    off_axis = dict(vignetting_centre=(0.1, -0.2), vignetting_colour=(-0.1, -0.1, 0.2))
    material = replace(material, setup=replace(material.setup, **off_axis))
    material.save(tmp_path / "m.matcap")
    loaded = Material.load(tmp_path / "m.matcap")
    assert torch.equal(loaded.maps(40, 30).stacked(), material.maps(40, 30).stacked())
    waves = [m.part(TunedDecoder).waves for m in (loaded, material)]
    assert waves[0] == waves[1] and loaded.setup == material.setup


def test_loaded_tensors_have_the_memory_layout_of_saved_ones(material, tmp_path):
    """Products of matrices round as their operands are aligned: bits would differ otherwise."""
    material.save(tmp_path / "m.matcap")
    loaded = Material.load(tmp_path / "m.matcap").part(TunedDecoder)
    read = (loaded.code, *loaded.decoder.parameters(), *(v for m in loaded.moments for v in m))
    assert all(tensor.data_ptr() % 64 == 0 for tensor in read)


def test_damaged_materials_are_refused_with_the_file_name(tmp_path):
    from safetensors.torch import load_file, save_file

    from matcap.files.tensors import write_tensors

    path = tmp_path / "m.matcap"
    noisy().save(path)
    good = path.read_bytes()
    bad = tmp_path / "bad.matcap"
    for data in (b"", good[:100], good[: len(good) // 2], b"not a material at all" * 50):
        bad.write_bytes(data)
        with pytest.raises(MatcapError, match="bad.matcap"):
            Material.load(bad)
    tensors = load_file(path)
    save_file(tensors, bad)
    with pytest.raises(MatcapError, match="not a matcap material"):
        Material.load(bad)
    from safetensors import safe_open

    with safe_open(path, framework="pt") as file:
        metadata = {"matcap": file.metadata()["matcap"]}
    for change, message in (
        ({"code": torch.zeros(3)}, "code has shape"),
        ({"code": torch.full((CODE_SIZE,), float("nan"))}, "code holds NaN"),
    ):
        write_tensors(bad, {**tensors, **change}, metadata)
        with pytest.raises(MatcapError, match=message):
            Material.load(bad)
    write_tensors(bad, {k: v for k, v in tensors.items() if k != "code"}, metadata)
    with pytest.raises(MatcapError, match="code is missing"):
        Material.load(bad)
    save_file(tensors, bad, metadata=metadata)  # without a digest
    with pytest.raises(MatcapError, match="damaged: its content does not match its digest"):
        Material.load(bad)
    for version in (4, 99):
        other = metadata["matcap"].replace('"version": 5', f'"version": {version}')
        save_file(tensors, bad, metadata={"matcap": other})
        with pytest.raises(MatcapError, match=f"of version {version}; this matcap reads 5 and 6"):
            Material.load(bad)


@pytest.mark.parametrize(
    ("seed", "period", "rectangle"),
    [
        (2**63, None, (0, 0, 8, 8)),
        (0, (10, 16), (0, 0, 8, 8)),
        (0, None, (0, 0, 0, 8)),
        (0, None, (0, 0, 8, -1)),
        (0, None, (2**40, 0, 8, 8)),
    ],
)
def test_rectangles_and_seeds_out_of_range_are_refused(seed, period, rectangle):
    with pytest.raises(UsageError):
        Field(noisy(), seed, period).read(*rectangle)


def test_noise_and_waves_are_exact_at_far_coordinates():
    far = 2**40 - 64
    wide = noise_field(Patch(1, Rectangle(far, -far, 64, 32)), 4)
    part = noise_field(Patch(1, Rectangle(far + 9, -far + 5, 55, 27)), 4)
    assert torch.equal(wide[:, 5:, 9:], part)
    wave = (Wave(0.1234567, 0.0),)
    near, distant = (
        wave_field(Patch(4, Rectangle(x, 0, 8, 1)), wave)[:2, 0].double() for x in (0, far)
    )
    turn = 2 * torch.pi * ((round(wave[0].fx * 2**64) * far) % 2**64) / 2**64
    cosine, sine = torch.cos(torch.tensor(turn)), torch.sin(torch.tensor(turn))
    assert torch.allclose(distant[0], near[0] * cosine - near[1] * sine, atol=2e-6)


# Opening whatever a user points at.


@pytest.fixture
def source_material(monkeypatch, maps):
    """Material.load gives something whose maps are known; it takes any file."""
    asked = []

    def load(path):
        def read(width, height, *, seed, period):
            asked.append((path.name, width, height, seed, period))
            return maps

        found = SimpleNamespace(maps=read, alignment=16, provenance={})
        found.by = lambda generator: found
        found.varied = lambda variety: found
        return found

    monkeypatch.setattr("matcap.field.material.Material.load", load)
    return asked


def test_a_material_file_is_read_at_the_size_and_seed_asked_for(tmp_path, source_material, maps):
    (tmp_path / "a.MATCAP").touch()
    for size, period in (((40, 30), None), ((48, 32), (48, 32))):
        assert open_tile(tmp_path / "a.MATCAP", size=size, seed=5).maps is maps
        assert source_material.pop() == ("a.MATCAP", *size, 5, period)


def test_a_folder_with_only_a_material_opens_it(tmp_path, source_material, maps):
    (tmp_path / "a.matcap").touch()
    (tmp_path / "report.json").write_text("{}")
    assert open_tile(tmp_path).maps is maps


def test_a_folder_means_its_material_and_a_map_sets_file_that_map_set(
    tmp_path, source_material, maps
):
    write_mapset(maps, tmp_path, MapSetInfo("a"))
    assert torch.equal(open_tile(tmp_path).maps.height, maps.height) and source_material == []
    (tmp_path / "a.matcap").touch()
    assert open_tile(tmp_path).maps is maps and len(source_material) == 1
    assert torch.equal(open_tile(tmp_path / "a.json").maps.height, maps.height)
    assert len(source_material) == 1


def test_size_or_seed_of_a_map_set_is_refused(tmp_path, maps):
    write_mapset(maps, tmp_path, MapSetInfo("a"))
    assert open_tile(tmp_path).name == "a"
    asked = {"size": {"size": (64, 64)}, "seed": {"seed": 0}}
    for option, value in (asked | {"generator": {"read": ReadOptions("decoder")}}).items():
        with pytest.raises(UsageError, match=f"--{option}: this is a map set"):
            open_tile(tmp_path, **value)


def test_a_folder_with_no_or_several_materials_is_refused(tmp_path, source_material):
    with pytest.raises(MatcapError, match="no map set and no material"):
        open_tile(tmp_path)
    with pytest.raises(MatcapError, match="no such file or folder"):
        open_tile(tmp_path / "none")
    for name in ("a.matcap", "b.matcap"):
        (tmp_path / name).touch()
    with pytest.raises(MatcapError, match=r"2 materials in this folder \(a.matcap, b.matcap\)"):
        open_tile(tmp_path)


# Threads on one core each, beside a process that uses more.


def threads_after_an_operator() -> int:
    torch.rand(1 << 16) * 2
    return torch.get_num_threads()


@pytest.mark.usefixtures("two_threads")
@pytest.mark.parametrize("workers", [1, 2])
def test_every_thread_computes_on_one_core_and_the_caller_on_its_own_number(workers):
    with single_threaded(workers) as pool:
        found = [pool.submit(threads_after_an_operator) for _ in range(8)]
        assert {one.result() for one in found} == {1} and threads_after_an_operator() == 2
    assert threads_after_an_operator() == 2


@pytest.mark.usefixtures("two_threads")
def test_one_thread_is_for_its_context_alone_and_restores_the_number_after_an_error():
    with suppress(ValueError), one_thread():
        assert torch.get_num_threads() == 1
        raise ValueError
    assert torch.get_num_threads() == 2


@pytest.fixture(params=["1", "2", "3"])
def some_workers(request, monkeypatch, two_threads):
    monkeypatch.setenv("OMP_NUM_THREADS", request.param)
    return int(request.param)


def test_a_process_beside_others_computes_on_one_core(some_workers):
    compute_alone()
    assert workers() == 1 and threads_after_an_operator() == 1


def test_tasks_at_once_are_as_many_as_allowed_and_each_computes_on_one_core(some_workers):
    inside, most, lock = set(), [], threading.Lock()

    def task(number, depth):
        with lock:
            inside.add(threading.get_ident())
            most.append(len(inside))
        found = at_once(*(partial(task, n, depth - 1) for n in range(3))) if depth else (number,)
        time.sleep(0.002)
        with lock:
            inside.discard(threading.get_ident())
        return threads_after_an_operator(), torch.is_grad_enabled(), found

    with torch.no_grad():
        results = at_once(*(partial(task, number, 1) for number in range(6)))
    assert [alone for alone, _, _ in results] == [1] * 6
    assert not any(gradients for _, gradients, _ in results)
    assert [found[2][0] for found in results[4][2]] == [0, 1, 2]
    assert max(most) <= some_workers and threads_after_an_operator() == 2


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
@pytest.mark.parametrize("place", [0, 1, 5])
def test_an_error_of_one_task_is_raised_when_no_other_is_running(some_workers, error, place):
    running, begun = [], []

    def task(number):
        begun.append(number)
        running.append(number)
        time.sleep(0.005)
        running.remove(number)
        if number == place:
            raise error(str(number))

    with pytest.raises(error, match=str(place)):
        at_once(*(partial(task, number) for number in range(40)))
    assert not running and len(begun) < 40
    assert at_once(partial(int, "1"), partial(str, 2)) == (1, "2")
