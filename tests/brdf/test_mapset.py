"""Map sets as folders, their validation, and heights at another resolution."""

import errno
import filecmp
import json
import os
import subprocess
from dataclasses import replace

import cv2
import numpy as np
import OpenEXR
import pytest
import torch
import torch.nn.functional as F

from matcap.brdf import folder as mapset
from matcap.brdf.edited import seam_ratio
from matcap.brdf.folder import (
    MapSetInfo,
    find_mapsets,
    mapset_bytes,
    mapset_files,
    read_mapset,
    write_mapset,
)
from matcap.brdf.heights import resized_height, with_slopes_of_means
from matcap.brdf.maps import MapSet
from matcap.errors import ExitCode, MatcapError

# Map-set folders: what stands in them, what comes back, what is refused.

INFO = MapSetInfo("leather", seed=7, origin=(-5, 2**33), provenance={"photo": "leather.dng"})
KINDS = ("diffuse", "specular", "roughness", "height", "normal")


def pixels(path):
    (channel,) = OpenEXR.File(str(path)).channels().values()
    return channel.pixels


def test_a_map_set_has_its_documented_files(tmp_path, maps):
    document = write_mapset(maps, tmp_path / "set", INFO)
    names = {f"leather_{kind}.exr" for kind in KINDS} | {"leather.json"}
    assert {f.name for f in (tmp_path / "set").iterdir()} == names
    assert document == tmp_path / "set" / "leather.json"
    for kind in KINDS:
        stored = pixels(tmp_path / "set" / f"leather_{kind}.exr")
        expected = getattr(maps, kind).movedim(0, -1).squeeze(-1).numpy()
        if kind == "height":
            assert stored.dtype == np.float32 and np.array_equal(stored, expected)
        else:
            assert stored.dtype == np.float16
            assert np.array_equal(stored, expected.astype(np.float16))


def test_the_document_states_units_and_ranges(tmp_path, maps):
    document = json.loads(write_mapset(maps, tmp_path, INFO).read_text())
    assert (document["width"], document["height"]) == (31, 20)
    assert (document["x"], document["y"], document["seed"]) == (-5, 2**33, 7)
    assert document["texel_size"] == maps.texel_size and document["height_scale"] == 1.0
    assert document["provenance"] == {"photo": "leather.dng"}
    assert document["conventions"]["normal"] == "+Y up (OpenGL)"


@pytest.mark.parametrize("normal", ["gl", "dx"])
def test_reading_gives_back_what_was_written(tmp_path, maps, normal):
    write_mapset(maps, tmp_path, INFO, normal=normal)
    back, document = read_mapset(tmp_path)
    assert torch.equal(back.height, maps.height)
    for kind in ("diffuse", "specular", "roughness"):
        assert torch.equal(getattr(back, kind), getattr(maps, kind).half().float())
    assert torch.equal(back.normal, maps.normal)  # from the height, so never flipped
    assert (back.texel_size, back.periodic) == (maps.texel_size, False)
    assert document["normal"] == normal
    assert torch.equal(read_mapset(tmp_path / "leather.json")[0].height, maps.height)


def test_directx_normals_have_green_turned_around(tmp_path, maps):
    write_mapset(maps, tmp_path / "gl", INFO)
    write_mapset(maps, tmp_path / "dx", INFO, normal="dx")
    gl = pixels(tmp_path / "gl" / "leather_normal.exr")
    dx = pixels(tmp_path / "dx" / "leather_normal.exr")
    assert np.array_equal(dx, gl * np.array([1, -1, 1], dtype=np.float16))
    assert np.abs(gl[..., 1]).max() > 0.1


def test_a_slope_that_rises_upwards_points_down_in_opengl(tmp_path, maps):
    # +y is up and row 0 is the top: height falling with the row index rises with y.
    rows = torch.arange(20.0)[None, :, None].expand(1, 20, 31)
    write_mapset(replace(maps, height=-0.1 * rows * maps.texel_size), tmp_path, INFO)
    assert (pixels(tmp_path / "leather_normal.exr")[..., 1] < -0.05).all()


def test_pngs_have_16_bits_and_decode_to_the_maps(tmp_path, maps):
    document = json.loads(write_mapset(maps, tmp_path, INFO, png=True).read_text())
    assert {f.name for f in tmp_path.iterdir()} == set(mapset_files("leather"))
    half_step = 0.5 / 65535 + 1e-7
    for kind in KINDS:
        stored = cv2.imread(str(tmp_path / f"leather_{kind}.png"), cv2.IMREAD_UNCHANGED)
        assert stored.dtype == np.uint16
        stored = stored[..., ::-1] if stored.ndim == 3 else stored
        value = stored / 65535.0
        expected = getattr(maps, kind).movedim(0, -1).squeeze(-1).double().numpy()
        if kind == "diffuse":
            high = value > 0.04045
            value = np.where(high, ((value + 0.055) / 1.055) ** 2.4, value / 12.92)
            assert np.abs(value - expected).max() < 2.4 * half_step
        elif kind == "normal":
            assert np.abs(2 * value - 1 - expected).max() < 2 * half_step
        elif kind == "height":
            scale, middle = document["png"]["height_scale"], document["png"]["height_midlevel"]
            assert np.abs((value - middle) * scale - expected).max() < scale * half_step
            assert (stored.min(), stored.max()) == (0, 65535)
        else:
            assert np.abs(value - expected).max() < half_step


def test_a_flat_height_becomes_middle_grey(tmp_path, maps):
    flat = replace(maps, height=torch.full_like(maps.height, 3.25), texel_size=0.01)
    document = json.loads(write_mapset(flat, tmp_path, INFO, png=True).read_text())
    stored = cv2.imread(str(tmp_path / "leather_height.png"), cv2.IMREAD_UNCHANGED)
    assert (stored == 32768).all()
    scale, middle = document["png"]["height_scale"], document["png"]["height_midlevel"]
    assert (32768 / 65535 - middle) * scale == pytest.approx(3.25, abs=1e-5)


def test_writing_again_gives_the_same_bytes(tmp_path, maps):
    for folder in ("a", "b"):
        write_mapset(maps, tmp_path / folder, INFO, png=True)
    for name in mapset_files("leather"):
        assert filecmp.cmp(tmp_path / "a" / name, tmp_path / "b" / name, shallow=False)


def test_a_new_set_replaces_the_old_one_pngs_included(tmp_path, maps):
    write_mapset(maps, tmp_path, INFO, png=True)
    (tmp_path / "notes.png").write_text("not ours")
    write_mapset(maps, tmp_path, MapSetInfo("leather", seed=8))
    left = {f.name for f in tmp_path.iterdir()}
    assert left == {f"leather_{kind}.exr" for kind in KINDS} | {"leather.json", "notes.png"}
    assert read_mapset(tmp_path)[1]["seed"] == 8


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
@pytest.mark.parametrize("kind", ["diffuse", "specular", "roughness", "height"])
def test_values_that_are_not_finite_leave_nothing(tmp_path, maps, kind, value):
    getattr(maps, kind)[0, 3, 4] = value
    with pytest.raises(MatcapError, match="not finite"):
        write_mapset(maps, tmp_path / "set", INFO)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("fails_at", ["leather_height.exr", "leather_normal.png", "leather.json"])
def test_a_full_disk_leaves_the_old_set(tmp_path, maps, monkeypatch, fails_at):
    write_mapset(maps, tmp_path, INFO, png=True)
    before = {f.name: f.read_bytes() for f in tmp_path.iterdir()}

    def failing(write):
        def wrapped(path, *args, **kwargs):
            if path.name == fails_at:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return write(path, *args, **kwargs)

        return wrapped

    monkeypatch.setattr(mapset, "write_exr", failing(mapset.write_exr))
    monkeypatch.setattr(mapset, "write_png", failing(mapset.write_png))
    monkeypatch.setattr("pathlib.Path.write_text", failing(type(tmp_path).write_text))
    with pytest.raises(MatcapError, match="the disk is full"):
        write_mapset(maps, tmp_path, MapSetInfo("leather", seed=9), png=True)
    kept = {f.name: f.read_bytes() for f in tmp_path.iterdir()} == before
    assert kept


@pytest.fixture
def tiny_disk(tmp_path):
    """A disk of 64 kB: only a real one tells what the libraries do when it is full."""
    place = tmp_path / "tiny"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(place)]
    try:
        mounted = subprocess.run(mount, capture_output=True, check=False).returncode == 0
    except OSError:
        mounted = False
    if not mounted:
        pytest.skip("mounting a small disk needs root")
    yield place
    subprocess.run(["umount", str(place)], check=True)


@pytest.mark.parametrize("png", [False, True])
def test_a_really_full_disk(tiny_disk, maps, png):
    side = 64 if png else 256  # PNGs come last: the EXR files of 64 x 64 still fit
    if png:
        (tiny_disk / "filler").write_bytes(bytes(20_000))
    big = maps.map(lambda m: torch.rand(m.shape[0], side, side))
    with pytest.raises(MatcapError, match="the disk is full"):
        write_mapset(big, tiny_disk / "set", INFO, png=png)
    assert [f.name for f in tiny_disk.iterdir()] == (["filler"] if png else [])


@pytest.mark.parametrize("name", ["", "a/b", "../a", ".hidden", "a\\b"])
def test_names_that_would_leave_the_folder_are_refused(tmp_path, maps, name):
    with pytest.raises(MatcapError, match="plain file name") as caught:
        write_mapset(maps, tmp_path / "set", MapSetInfo(name))
    assert caught.value.exit_code == ExitCode.USAGE and list(tmp_path.iterdir()) == []


def test_batches_are_refused(tmp_path, maps):
    with pytest.raises(ValueError, match="batch"):
        write_mapset(maps.map(lambda m: m[None]), tmp_path / "set", INFO)


def test_folders_without_a_set_and_with_several(tmp_path, maps):
    with pytest.raises(MatcapError, match="no such file or folder"):
        read_mapset(tmp_path / "none")
    (tmp_path / "report.json").write_text('{"format": "matcap report"}')
    (tmp_path / "broken.json").write_text("{")
    with pytest.raises(MatcapError, match="no map set in this folder"):
        read_mapset(tmp_path)
    with pytest.raises(MatcapError, match="not the JSON file of a map set"):
        read_mapset(tmp_path / "report.json")
    for name in ("one", "two"):
        write_mapset(maps, tmp_path, MapSetInfo(name))
    assert [f.name for f in find_mapsets(tmp_path)] == ["one.json", "two.json"]
    with pytest.raises(MatcapError, match=r"2 map sets in this folder \(one.json, two.json\)"):
        read_mapset(tmp_path)


def test_missing_and_corrupt_maps_are_named(tmp_path, maps):
    write_mapset(maps, tmp_path, INFO)
    file = tmp_path / "leather_roughness.exr"
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2])
    with pytest.raises(MatcapError, match="leather_roughness.exr: the file is truncated"):
        read_mapset(tmp_path)
    file.unlink()
    with pytest.raises(MatcapError, match="leather_roughness.exr: the file is missing"):
        read_mapset(tmp_path)
    file.write_bytes((tmp_path / "leather_diffuse.exr").read_bytes())
    with pytest.raises(MatcapError, match="has 3 channels instead of 1"):
        read_mapset(tmp_path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"version": 2}, "version 2, this matcap reads 1; update matcap"),
        ({"width": 30}, "is 31 x 20 texels, not 30 x 20"),
        ({"width": 0}, "'width' is 0, not from 1 to"),
        ({"width": "wide"}, "'width' is 'wide', no whole number"),
        ({"width": 2**40}, "'width' is 1099511627776, not from 1 to 2147483647"),
        ({"texel_size": float("nan")}, "'texel_size' is nan, not from 1e-09 to 1000"),
        ({"texel_size": 0}, "'texel_size' is 0, not from"),
        ({"height_scale": float("inf")}, "'height_scale' is inf, not from"),
        ({"normal": "zz"}, "'normal' is 'zz', neither 'gl' nor 'dx'"),
        ({"periodic": 1}, "'periodic' is 1, neither true nor false"),
        ({"name": "../../victim/keep"}, "which leads to another folder"),
        ({"name": "a\nb"}, "which has characters that do not print"),
        ({"name": 3}, "'name' is 3, which is no text"),
        ({"provenance": 3}, "'provenance' is 3, no object"),
        ({"provenance": {"millimetres_per_unit": float("nan")}}, "'millimetres_per_unit' is nan"),
        ({"provenance": {"card": {"millimetres_per_unit": -1}}}, "'millimetres_per_unit' is -1"),
        ({"maps": {}}, "'maps' names no file of 'diffuse'"),
        ({"maps": None}, "'maps' is None, no list of maps"),
    ],
)
def test_documents_that_do_not_fit_are_refused(tmp_path, maps, change, said):
    file = write_mapset(maps, tmp_path, INFO)
    file.write_text(json.dumps(json.loads(file.read_text()) | change))
    with pytest.raises(MatcapError, match=said):
        read_mapset(tmp_path)


def test_documents_cannot_name_files_elsewhere(tmp_path, maps):
    file = write_mapset(maps, tmp_path / "set", INFO)
    document = json.loads(file.read_text())
    document["maps"]["height"]["file"] = "../secret.exr"
    file.write_text(json.dumps(document))
    said = "'file of height' is '../secret.exr', which leads to another folder"
    with pytest.raises(MatcapError, match=said):
        read_mapset(tmp_path / "set")


def test_a_height_scale_is_heeded_and_numbers_nobody_knows_are_none(tmp_path, maps):
    file = write_mapset(maps, tmp_path, INFO)
    stated = {"height_scale": 2.0, "provenance": {"contrast": float("nan"), "list": [1, 1e999]}}
    file.write_text(json.dumps(json.loads(file.read_text()) | stated))
    back, document = read_mapset(tmp_path)
    assert torch.equal(back.height, 2.0 * maps.height)
    assert document["provenance"] == {"contrast": None, "list": [1, None]}


def test_the_estimated_disk_space_suffices(tmp_path, maps):
    write_mapset(maps.map(lambda m: torch.rand(m.shape[0], 200, 200)), tmp_path, INFO, png=True)
    taken = sum(f.stat().st_size for f in tmp_path.iterdir())
    assert taken < mapset_bytes(200, 200, png=True) < taken + 2_000_000


def test_a_set_with_all_maps_in_one_file_is_read(tmp_path, maps):
    """Map sets of an earlier version may be such (synth --single)."""
    written = write_mapset(maps, tmp_path, INFO)
    before, document = read_mapset(tmp_path)
    channels = {}
    for kind, about in document["maps"].items():
        named = OpenEXR.File(str(tmp_path / about["file"]), separate_channels=True).channels()
        own = [letter for letter in "RGBY" if letter in named]
        channels |= {f"{kind}.{letter}": named[letter].pixels for letter in own}
        about |= {"file": "leather_maps.exr", "channels": [f"{kind}.{letter}" for letter in own]}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(tmp_path / "leather_maps.exr"))
    written.write_text(json.dumps(document))
    assert torch.equal(read_mapset(tmp_path)[0].stacked(), before.stacked())


# The measure of seams, on maps whose seams are known.

SEAMLESS = 1.15  # invisible: single lines of a texture scatter by as much


def smooth(*, circular: bool) -> MapSet:
    """Blotches eight texels wide that wrap around, or do not."""
    noise = torch.rand(1, 6, 128, 128, generator=torch.Generator().manual_seed(1))
    mode = "circular" if circular else "reflect"
    for _ in range(2):
        noise = F.avg_pool2d(F.pad(noise, (4, 4, 4, 4), mode=mode), 9, 1)
    return MapSet.from_stacked(noise[0], 0.01, periodic=circular)


def test_maps_that_wrap_have_no_seam_and_others_have():
    assert seam_ratio(smooth(circular=True)) <= SEAMLESS
    assert seam_ratio(smooth(circular=False)) > 2.0


def test_the_worse_axis_counts():
    maps = smooth(circular=True)
    assert seam_ratio(maps.crop(0, 0, 100, 128)) > 2.0 < seam_ratio(maps.crop(0, 0, 128, 100))


def test_constant_maps_have_no_seam():
    assert seam_ratio(MapSet.from_stacked(torch.full((6, 16, 16), 0.5), 0.1)) == pytest.approx(1.0)
    assert seam_ratio(MapSet.from_stacked(torch.zeros(6, 2, 2), 0.1)) == 1.0


@pytest.mark.parametrize("circular", [True, False])
def test_a_map_set_records_its_seam(tmp_path, circular):
    maps = smooth(circular=circular)
    write_mapset(maps, tmp_path, MapSetInfo("a"))
    document = read_mapset(tmp_path)[1]
    assert document["periodic"] is circular
    assert document["seam"] == pytest.approx(seam_ratio(maps), abs=1e-3)


# Heights at another resolution keep the mean slopes that the normals of a map set show.


INSIDE = slice(8, -8)  # of a border, where central differences are one-sided


def waves(period, angle, side=480):
    """(side, side) heights, of a wavelength in texels."""
    y, x = np.mgrid[:side, :side]
    along = np.cos(angle) * x + np.sin(angle) * y
    return np.cos(2.0 * np.pi * along / period + 0.3).astype(np.float32)


def slopes(heights):
    return np.stack(np.gradient(heights))


def means(planes, side):
    return np.stack([cv2.resize(p, (side, side), interpolation=cv2.INTER_AREA) for p in planes])


def energy(planes):
    return float(np.square(planes[:, INSIDE, INSIDE]).mean())


@pytest.mark.parametrize("angle", [0.0, 0.5, np.pi / 4.0])
@pytest.mark.parametrize("period", [4.0, 5.0, 8.0, 20.0])
def test_halved_heights_have_the_energy_of_the_mean_slopes(period, angle):
    fine = waves(2.0 * period, angle)
    halved = slopes(resized_height(fine, (240, 240))) / 2.0
    wanted = means(slopes(fine), 240)
    assert energy(halved) == pytest.approx(energy(wanted), rel=0.05)
    averaged = slopes(cv2.resize(fine, (240, 240), interpolation=cv2.INTER_AREA)) / 2.0
    assert energy(averaged) < energy(halved)
    if period == 4.0 and angle == 0.0:
        assert energy(averaged) < 0.55 * energy(wanted)


@pytest.mark.parametrize("times", [2, 3])
@pytest.mark.parametrize("period", [4.0, 6.0, 16.0])
def test_enlarged_heights_have_the_slopes_of_their_waves(period, times):
    fine = slopes(resized_height(waves(period, 0.0, 120), (120 * times, 120 * times)))
    at = (np.arange(120 * times) + 0.5) / times - 0.5
    turn = 2.0 * np.pi / period
    true = np.broadcast_to(-turn * np.sin(turn * at + 0.3) / times, fine[0].shape)
    assert energy(fine - np.stack([0.0 * true, true])) < 0.03 * energy(true[None])


@pytest.mark.parametrize("place", range(60, 64))
def test_slopes_of_a_step_hardly_ring(place):
    step = np.zeros((48, 128), np.float32)
    step[:, place:] = 1.0
    small = resized_height(step, (64, 24))
    across = np.gradient(small[12]) / 2.0
    largest = np.gradient(step[0]).max()
    assert across.min() > -0.12 * largest and across.max() < 1.12 * largest
    assert small.min() > -0.4 and small.max() < 1.4


def test_ramps_stay_ramps():
    y, x = np.mgrid[:96, :128].astype(np.float32)
    down, across = np.gradient(resized_height(0.3 * x - 0.2 * y, (64, 48)))
    assert across == pytest.approx(0.6, abs=1e-4) and down == pytest.approx(-0.4, abs=1e-4)


def test_white_noise_does_not_grow():
    """What central differences do not show, waves of two texels, is as in the area mean."""
    noise = np.random.default_rng(1).standard_normal((256, 256)).astype(np.float32)
    small = resized_height(noise, (128, 128))
    mean = cv2.resize(noise, (128, 128), interpolation=cv2.INTER_AREA)
    assert small.std() < 1.6 * mean.std()


@pytest.mark.parametrize("angle", [0.0, 0.5])
@pytest.mark.parametrize(("period", "least"), [(4.0, 0.66), (6.0, 0.9), (12.0, 0.98)])
def test_means_of_heights_get_slopes_nearer_to_those_of_their_surface(period, least, angle):
    fine = waves(4.0 * period, angle)
    (mean,) = means([fine], 120)
    wanted = energy(means(4.0 * slopes(fine), 120))
    raised = with_slopes_of_means(mean)
    assert max(least, energy(slopes(mean)) / wanted) < energy(slopes(raised)) / wanted < 1.01


def test_ramps_are_not_raised():
    y, x = np.mgrid[:81, :120].astype(np.float32)
    ramp = 0.3 * x - 0.2 * y
    assert with_slopes_of_means(ramp)[INSIDE, INSIDE] == pytest.approx(
        ramp[INSIDE, INSIDE], abs=1e-3
    )
