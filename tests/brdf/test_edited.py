"""Map sets that other programs edited."""

import json
import struct
import warnings

import numpy as np
import pytest
import torch
from other_exr import write_other_exr

from matcap.brdf.adjust import Adjustments, adjusted
from matcap.brdf.folder import MapSetInfo, read_mapset, write_mapset
from matcap.brdf.heights import integrate, integrate_periodic
from matcap.errors import MatcapError
from matcap.files.color import REC709
from matcap.files.exr import read_exr, write_exr
from matcap.files.names import Note

# Map sets of which another program opened and saved a map.

INFO = MapSetInfo("leather")


def resave(file, *planes, names="RGBA"):
    write_other_exr(file, dict(zip(names, planes, strict=False)))


@pytest.fixture
def written(tmp_path, maps):
    write_mapset(maps, tmp_path, INFO)
    return tmp_path, read_mapset(tmp_path)[0]


def quietly(folder):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return read_mapset(folder)[0]


def same(found, expected):
    assert torch.equal(found.stacked(), expected.stacked())


def test_an_opaque_alpha_is_left_out_of_every_map(written):
    folder, expected = written
    for kind in ("diffuse", "specular", "roughness", "height", "normal"):
        file = folder / f"leather_{kind}.exr"
        found = read_exr(file).pixels
        planes = [*np.moveaxis(found, -1, 0)]
        planes = planes if len(planes) == 3 else planes * 3
        resave(file, *planes, np.ones(found.shape[:2]))
    same(quietly(folder), expected)


def test_grey_as_grey_and_alpha_or_as_three_channels(written):
    folder, expected = written
    (plane,) = np.moveaxis(read_exr(folder / "leather_roughness.exr").pixels, -1, 0)
    resave(folder / "leather_roughness.exr", plane, np.ones_like(plane), names="YA")
    (plane,) = np.moveaxis(read_exr(folder / "leather_height.exr").pixels, -1, 0)
    resave(folder / "leather_height.exr", plane, plane, plane)
    same(quietly(folder), expected)


def test_a_transparent_alpha_is_noted(written):
    folder, expected = written
    planes = np.moveaxis(read_exr(folder / "leather_diffuse.exr").pixels, -1, 0)
    resave(folder / "leather_diffuse.exr", *planes, np.full(planes[0].shape, 0.5))
    with pytest.warns(Note, match="transparency is not used"):
        same(read_mapset(folder)[0], expected)


def test_a_colour_where_there_can_be_none_is_refused(written):
    folder, _ = written
    (plane,) = np.moveaxis(read_exr(folder / "leather_roughness.exr").pixels, -1, 0)
    resave(folder / "leather_roughness.exr", plane, 0.9 * plane, plane)
    with pytest.raises(MatcapError, match="3 channels instead of 1"):
        read_mapset(folder)


def test_primaries_of_another_program_are_converted(written):
    folder, expected = written
    file = folder / "leather_diffuse.exr"
    stored = file.read_bytes()
    rec709, p3 = (
        struct.pack("<8f", *one)
        for one in (REC709, (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290))
    )
    assert rec709 in stored
    file.write_bytes(stored.replace(rec709, p3))
    with pytest.warns(Note, match="primaries"):
        found = read_mapset(folder)[0]
    to_rec709 = [[1.2249, -0.2247, 0.0], [-0.0420, 1.0419, 0.0], [-0.0197, -0.0786, 1.0979]]
    converted = np.tensordot(to_rec709, expected.diffuse.numpy(), 1)
    np.testing.assert_allclose(found.diffuse, np.maximum(converted, 0.0), atol=2e-3)
    file.write_bytes(stored.replace(rec709, struct.pack("<8f", *[0.3] * 8)))
    with pytest.raises(MatcapError, match="no colour space"):
        read_mapset(folder)


# Heights of slopes in closed form, and normal files that were edited.


@pytest.mark.parametrize("normal", ["gl", "dx"])
def test_a_set_as_it_was_written_has_no_note(tmp_path, maps, normal):
    write_mapset(maps, tmp_path, MapSetInfo("moss"), normal=normal)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_mapset(tmp_path)


def painted(normals):
    normals[5:15, 5:15] = (0.6, 0.0, 0.8)
    return normals


def moss(folder, maps, change):
    """A map set whose normals are changed."""
    write_mapset(maps, folder, MapSetInfo("moss"))
    file = folder / "moss_normal.exr"
    write_exr(file, change(read_exr(file).pixels).astype(np.float32), half=False)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (painted, "differs from the height at 1[0-9]"),
        (lambda normals: normals[:10], "is 31 x 10 texels, not 31 x 20"),
        (lambda normals: normals[..., 0], "differs from the height at 100"),
        (lambda normals: normals * np.array([1, -1, 1]), "differs from the height at"),
    ],
)
def test_an_edited_normal_is_noted(tmp_path, maps, change, said):
    moss(tmp_path, maps, change)
    with pytest.warns(Note, match=f"moss_normal.exr: {said}.*it is not read"):
        read_mapset(tmp_path)


def test_invalid_normals_are_noted(tmp_path, maps):
    write_mapset(maps, tmp_path, MapSetInfo("moss"))
    broken = np.full((20, 31, 3), np.nan, np.float32)
    write_other_exr(tmp_path / "moss_normal.exr", {"RGB": broken})
    with pytest.warns(Note, match="has values that are not finite"):
        read_mapset(tmp_path)


def test_a_set_without_a_normal_file_is_whole(tmp_path, maps):
    file = write_mapset(maps, tmp_path, MapSetInfo("moss"))
    document = json.loads(file.read_text())
    del document["maps"]["normal"]
    file.write_text(json.dumps(document))
    read_mapset(tmp_path)


@pytest.mark.parametrize("style", ["gl", "dx"])
def test_painted_normals_are_read_on_request(tmp_path, maps, style):
    write_mapset(maps, tmp_path, MapSetInfo("moss"), normal=style)
    file = tmp_path / "moss_normal.exr"
    normals = read_exr(file).pixels
    normals[5:15, 5:15] = (0.36, 0.48 if style == "gl" else -0.48, 0.8)
    write_exr(file, 2.0 * normals, half=False)  # of no unit length
    found, _ = read_mapset(tmp_path, normals="file")
    assert torch.allclose(found.normal[:, 10, 10], torch.tensor([0.36, 0.48, 0.8]), atol=1e-3)
    assert torch.allclose(found.normal[:, :4], maps.normal[:, :4], atol=2e-3)
    assert torch.equal(found.crop(5, 5, 4, 4).normal[:, 0, 0], found.normal[:, 5, 5])


def test_relief_that_is_adjusted_takes_the_painting_along(tmp_path, maps):
    write_mapset(maps, tmp_path, MapSetInfo("moss"))
    found, _ = read_mapset(tmp_path, normals="file")
    steeper = adjusted(found, Adjustments(relief=2.0)).normal
    slopes, doubled = (normal[:2] / normal[2:] for normal in (found.normal, steeper))
    assert torch.allclose(doubled, 2.0 * slopes, atol=1e-5)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda normals: normals[:10], "is 31 x 10 texels"),
        (lambda normals: normals[..., 0], "has 1 channels"),
        (lambda normals: -normals, "normals of 620 texels do not face upwards"),
        (lambda normals: 0.0 * normals, "normals of 620 texels"),
    ],
)
def test_invalid_normals_are_refused_on_request(tmp_path, maps, change, said):
    moss(tmp_path, maps, change)
    with pytest.raises(MatcapError, match=f"moss_normal.exr.*{said}"):
        read_mapset(tmp_path, normals="file")


def waves(rows, columns, texel):
    """(H, W) height and its (2, H, W) slopes, y upwards, of a few waves that repeat."""
    y, x = np.mgrid[:rows, :columns].astype(np.float64)
    height, slopes = np.zeros((rows, columns)), np.zeros((2, rows, columns))
    for size, across, down, phase in ((1.0, 2, 0, 0.1), (0.5, 3, -2, 1.0), (0.3, 0, 5, 2.0)):
        wx, wy = 2.0 * np.pi * across / columns, 2.0 * np.pi * down / rows
        angle = wx * x + wy * y + phase
        height += size * np.sin(angle)
        slopes += size * np.cos(angle) * np.array([wx, -wy])[:, None, None] / texel
    return height, slopes


@pytest.mark.parametrize(("rows", "columns", "texel"), [(32, 48, 1.0), (33, 25, 0.01)])
def test_a_surface_comes_back_from_its_slopes(rows, columns, texel):
    height, slopes = waves(rows, columns, texel)
    found = integrate_periodic(slopes, texel)
    np.testing.assert_allclose(found[0], height, atol=1e-5)
    assert found.dtype == np.float32


def test_means_and_curl_that_no_repeating_surface_has_are_left_out():
    height, slopes = waves(32, 32, 1.0)
    tilted = slopes + np.array([0.3, -0.2])[:, None, None]
    rolling = np.stack([slopes[1], -slopes[0]])  # the slopes' field turned: all curl
    np.testing.assert_allclose(integrate_periodic(tilted)[0], height, atol=1e-5)
    np.testing.assert_allclose(integrate_periodic(rolling), 0.0, atol=1e-5)


@pytest.mark.parametrize(("height", "width"), [(64, 96), (63, 97)])
def test_a_height_is_recovered_from_its_differences(height: int, width: int) -> None:
    noise = np.random.default_rng(0).standard_normal((height, width)).astype(np.float32)
    found = integrate(np.diff(noise, axis=1), np.diff(noise, axis=0))
    expected = noise - noise.mean()
    inner = (slice(4, -4), slice(4, -4)) if height % 2 else (slice(None), slice(None))
    assert np.abs((found - expected)[inner]).max() < (0.2 if height % 2 else 1e-3)


def test_the_curl_of_slopes_is_left_out() -> None:
    """A slope field that turns in circles belongs to no surface."""
    y, x = np.meshgrid(np.linspace(-4, 4, 64), np.linspace(-4, 4, 64), indexing="ij")
    swirl = np.exp(-(np.square(x) + np.square(y))).astype(np.float32)

    def between(across: np.ndarray, down: np.ndarray) -> np.ndarray:
        columns, rows = across[:, 1:] + across[:, :-1], down[1:] + down[:-1]
        return integrate(columns.astype(np.float32), rows.astype(np.float32))

    turned = between(-y * swirl, x * swirl)
    downhill = between(-x * swirl, -y * swirl)
    assert np.abs(turned).max() < 0.05 * np.abs(downhill).max()
