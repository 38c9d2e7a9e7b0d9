"""Random requests of fields, previews, clusters."""

import hashlib
import json
import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
import torch
from draws import run
from PIL import Image
from repetition import correlations

from matcap.brdf.folder import MapSetInfo, read_mapset, write_mapset
from matcap.cli.main import main
from matcap.field.field import Field
from matcap.field.material import Material
from matcap.field.plane import Rectangle
from matcap.files.exr import read_exr
from matcap.relight.render import Renderer
from matcap.relight.scene import Camera, DirectionalLight, Film, Scene, Surface
from matcap.space.random_field import Patch, noise_field
from matcap.synth.pictures import preview_of
from matcap.synth.request import SynthRequest, Work
from matcap.synth.stream import synthesise

# The field is one function, however it is read, and never repeats unless asked to.


@pytest.mark.parametrize(("kind", "draws", "seed"), [("material", 60, 0), ("wavy", 20, 1)])
def test_random_rectangles_orders_and_workers_give_the_same_bits(request, kind, draws, seed):
    assert run(request.getfixturevalue(kind), draws, seed) == draws


def test_an_endless_field_does_not_repeat(material):
    own, others = correlations(material, 768)
    assert max(own) < 1.2 * max(others)


def test_the_repetition_test_finds_a_repetition(material):
    """A field of period 256 read as if it were endless."""
    own, _ = correlations(material, 768, seeds=(1,), period=(256, 256))
    assert max(own) > 0.99


@pytest.mark.parametrize("place", [0, 2**31, 2**40 - 256])
def test_the_hash_is_uniform_and_independent(place):
    """Chi-square, correlation and the sign patterns of neighbours, within five deviations."""
    noise = noise_field(Patch(5, Rectangle(place, -place, 256, 256)), 6).numpy()
    levels = np.floor((noise / 12**0.5 + 0.5) * 64).astype(int)
    for channel in levels:
        counts = np.bincount(channel.ravel(), minlength=64)
        expected = channel.size / 64
        assert abs(((counts - expected) ** 2 / expected).sum() - 63) < 5 * (2 * 63) ** 0.5
    deviation = 1 / 256
    others = noise_field(Patch(6, Rectangle(place, -place, 256, 256)), 6).numpy()
    for a in range(6):
        for shift in ((0, 1), (1, 0), (1, 1), (16, 0), (0, 64)):
            assert abs((noise[a] * np.roll(noise[a], shift, (0, 1))).mean()) < 5 * deviation
        assert abs((noise[a] * others[a]).mean()) < 5 * deviation
        for b in range(a):
            assert abs((noise[a] * noise[b]).mean()) < 5 * deviation


def test_every_bit_of_seed_and_place_changes_half_of_the_hash():
    one = noise_field(Patch(0, Rectangle(0, 0, 32, 32)), 4)
    for bit in (5, 20, 31, 39):
        for changed in (
            noise_field(Patch(2**bit, Rectangle(0, 0, 32, 32)), 4),
            noise_field(Patch(0, Rectangle(2**bit, 0, 32, 32)), 4),
            noise_field(Patch(0, Rectangle(0, -(2**bit), 32, 32)), 4),
        ):
            # The sign is a hash's top bit: it should be a coin's toss.
            assert abs(float((one.sign() != changed.sign()).float().mean()) - 0.5) < 0.05


# NAME_preview.png: what is written, one pixel a texel, lit from the top, and where it repeats.

DISTANCE = math.hypot(2.0, 1.2)


def rendered(maps):
    """What the renderer makes of maps from straight above, and how bright the preview shows it."""
    width, height = maps.size
    camera = Camera("orthographic", scale=max(maps.size) * maps.texel_size / 2)
    sun = DirectionalLight((0.0, 2.0, 1.2), (math.pi * DISTANCE / 1.2,) * 3)
    scene = Scene(Film(width, height), camera, Surface(size=None), (sun,))
    radiance = Renderer(maps, scene).render(effects="none,+diffuse,+specular").radiance
    radiance = np.clip(radiance, 0.0, 1.0)
    gain = np.clip(0.5 / np.quantile(radiance[::8, ::8], 0.99), 1.0, 4.0)
    light = np.clip(gain * radiance, 0.0, 1.0)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055) * 255.0


def written(material, folder, area, **asked):
    """The preview and the maps of a request."""
    document = synthesise(SynthRequest(material, area, **asked), folder)
    preview = document.with_name(f"{document.stem}_preview.png")
    return np.asarray(Image.open(preview)).astype(float), document


@pytest.mark.parametrize("normal", ["gl", "dx"])
def test_the_preview_equals_the_rendered_maps(material, tmp_path, normal):
    shown, document = written(material, tmp_path, Rectangle(-20, 7, 90, 50), normal=normal)
    expected = rendered(read_mapset(document, "file")[0])
    assert shown.shape == expected.shape
    assert np.abs(shown - expected).max() < 2.0  # maps in the files are half floats
    assert expected.std() > 1.0


@pytest.mark.parametrize(("tile", "copies"), [("both", (2, 2)), ("x", (1, 2)), ("y", (2, 1))])
def test_copies_of_what_repeats_meet_in_its_middle(material, tmp_path, tile, copies):
    shown, document = written(material, tmp_path, Rectangle(5, 3, 48, 32), tile=tile)
    expected = np.tile(rendered(read_mapset(document, "file")[0]), (*copies, 1))
    inside = shown[16:-16, 16:-16]
    # The exposure is read from every eighth row and column, as those of copies are.
    assert np.abs(inside - expected).max() < 3.0
    ink = (shown == [240, 180, 41]).all(axis=2)
    (height, width), across, down = ink.shape, ink.any(axis=0), ink.any(axis=1)
    middle_x, middle_y = width // 2, height // 2
    assert ink[0, middle_x] == ink[-1, middle_x] == (tile != "y")
    assert ink[middle_y, 0] == ink[middle_y, -1] == (tile != "x")
    assert across[:middle_x].sum() == across[middle_x:].sum()
    assert down[:middle_y].sum() == down[middle_y:].sum() and not ink[16:-16, 16:-16].any()


def test_a_texture_set_has_one_of_all_its_tiles(material, tmp_path):
    shown, _ = written(material, tmp_path / "set", Rectangle(0, 0, 32, 24), udim=(2, 2))
    whole, _ = written(material, tmp_path / "whole", Rectangle(0, 0, 64, 48))
    assert np.array_equal(shown, whole)


def test_without_a_preview_an_older_one_is_removed(material, tmp_path):
    area = Rectangle(0, 0, 16, 16)
    written(material, tmp_path, area)
    document = synthesise(SynthRequest(material, area, preview=False), tmp_path, Work())
    assert not list(tmp_path.glob("*.png")) and document.is_file()


@pytest.mark.parametrize(
    ("whole", "repeats", "shown"),
    [
        ((4096, 256), False, (0, 0, 4096, 256)),
        ((3072, 2304), False, (1024, 640, 1024, 1024)),
        ((2**30, 2**30), False, (2**29 - 512, 2**29 - 512, 1024, 1024)),
        ((2**30, 2**30), True, (-512, -512, 1024, 1024)),
        ((2**30, 1), False, (2**29 - 2**19, 0, 2**20, 1)),
        ((16, 2048), True, (-16, -512, 32, 1024)),
    ],
)
def test_about_a_megapixel_is_shown_of_any_size(whole, repeats, shown):
    preview = preview_of(Rectangle(7, -5, *whole), whole if repeats else None)
    x, y, width, height = shown
    assert preview.shown == Rectangle(7 + x, y - 5, width, height)
    assert preview.repeats == (repeats, repeats)


def test_maps_written_over_synthesised_ones_leave_no_preview_of_those(material, tmp_path):
    _, document = written(material, tmp_path, Rectangle(0, 0, 16, 16))
    write_mapset(material.maps(16, 16), tmp_path, MapSetInfo(document.stem))
    assert not list(tmp_path.glob("*_preview.png"))


# What synth makes of a material does not change: files that were written before are the measure.
#
# Beside this file, in `before/`: a small material with random weights, the maps of a corner of its
# field, and digests of what `matcap synth` wrote of it. Bits are the same on one machine and build
# (docs/guide/how-it-works.md): the digests are compared where processor and PyTorch are those they
# were written with; the corner is compared everywhere.
#
# Written again, after a change that is meant to change bits, by
# `python tests/synth/test_field_draws.py`.

BEFORE = Path(__file__).with_name("before")
MATERIAL = BEFORE / "before.matcap"
SEED, CORNER = 7, (-12, -9, 24, 16)
CALLS = {
    "size": ["--size", "96x64", "-j", "1"],
    "region": ["--region", "-40,-24,96,64", "-j", "2", "--normal", "dx"],
    "tile": ["--size", "64x48", "--tile", "both"],
}


def where():
    """What bits depend on."""
    return [torch.__version__, torch.backends.cpu.get_cpu_capability()]


def corner():
    """(6, H, W) maps around the field's origin, two blocks and more."""
    return Field(Material.load(MATERIAL), SEED).read(*CORNER).stacked().numpy()


def digests(words, folder):
    """Of every map that synth writes, and of what the document says."""
    assert main(["synth", str(MATERIAL), "--seed", str(SEED), *words, "-q", "-o", str(folder)]) == 0
    found = {}
    for file in sorted([*folder.glob("*.exr"), *folder.glob("*.json")]):
        if file.suffix == ".json":
            content = json.dumps(json.loads(file.read_text()) | {"matcap": "any"}).encode()
        else:
            content = read_exr(file).pixels.tobytes()
        found[file.name] = hashlib.sha256(content).hexdigest()
    return found


def test_fields_of_earlier_versions_are_bit_identical():
    np.testing.assert_allclose(corner(), np.load(BEFORE / "corner.npy"), atol=1e-4)


@pytest.mark.parametrize("call", CALLS)
def test_synth_writes_the_bits_of_earlier_versions(call, tmp_path):
    before = json.loads((BEFORE / "digests.json").read_text())
    if before["where"] != where():
        pytest.skip(f"written with {before['where']}")
    assert digests(CALLS[call], tmp_path / "maps") == before["digests"][call]


def test_a_material_is_written_as_it_was_read(tmp_path):
    again = tmp_path / "again.matcap"
    Material.load(MATERIAL).save(again)
    assert again.read_bytes() == MATERIAL.read_bytes()


if __name__ == "__main__":
    np.save(BEFORE / "corner.npy", corner())
    with tempfile.TemporaryDirectory() as scratch:
        made = {name: digests(words, Path(scratch) / name) for name, words in CALLS.items()}
    text = json.dumps({"where": where(), "digests": made}, indent=2)
    (BEFORE / "digests.json").write_text(text + "\n")
