import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.flash.geometry import FlashSetup, plane_points, project
from matcap.flash.rectify import rectify
from matcap.flash.render import render_rectified
from matcap.photo.load import load_photo
from matcap_lab.simulate.hand_held import PhonePhotographs
from matcap_lab.simulate.photograph import PhoneCamera, as_photo, expose, take, true_maps
from matcap_lab.simulate.specimen import EXAMPLES

CAMERA = PhoneCamera(width=128, height=96)


def _flat(width, height, texel_size):
    """Uniform matte grey: its photograph has a closed form."""
    full = torch.ones(1, height, width, dtype=torch.float64)
    return MapSet(0.4 * full.expand(3, -1, -1), 0.04 * full, 0.9 * full, 0 * full, texel_size)


def test_untilted_photograph_is_the_renderer_s():
    setup = FlashSetup(offset=(0.1, 0.05, 0.0))
    shot = take(_flat, CAMERA, setup)
    truth = render_rectified(true_maps(_flat, CAMERA, setup), shot.setup)
    # The lens's blur has less to draw on at the border.
    inner = slice(2, -2)
    expected = truth.permute(1, 2, 0).numpy()[inner, inner]
    np.testing.assert_allclose(shot.linear[inner, inner], expected, rtol=2e-3)


def test_tilt_moves_points_to_where_they_project():
    """A bright dot on the plane is found in the picture where geometry says."""
    setup = FlashSetup(tilt=(math.radians(6.0), math.radians(-4.0)))

    def dot(width, height, texel_size):
        maps = _flat(width, height, texel_size)
        x = (torch.arange(width) + 0.5 - width / 2) * texel_size
        y = (height / 2 - 0.5 - torch.arange(height)) * texel_size
        near = (x[None, :] - 0.7).square() + (y[:, None] + 0.5).square() < 0.02**2
        return MapSet(
            torch.where(near, 0.9, 0.01).expand(3, -1, -1).double(),
            maps.specular,
            maps.roughness,
            maps.height,
            texel_size,
        )

    shot = take(dot, PhoneCamera(width=256, height=192), setup)
    weight = np.where(shot.linear[..., 0] > 0.5 * shot.linear.max(), shot.linear[..., 0], 0.0)
    rows, columns = np.mgrid[0:192, 0:256]
    found = (
        ((columns + 0.5) * weight).sum() / weight.sum() / 128 - 1.0,
        (96.0 - (rows * weight).sum() / weight.sum() - 0.5) / 128,
    )
    place = torch.tensor([0.7, -0.5, 0.0], dtype=torch.float64)[:, None]
    expected = project(place, shot.setup)[:, 0]
    np.testing.assert_allclose(found, expected.numpy(), atol=0.004)


def test_strips_do_not_show():
    """Shading goes by strips of rows; normals at their borders must be those of the whole."""
    setup = FlashSetup(offset=(0.1, 0.0, 0.0))
    camera = PhoneCamera(width=128, height=96, supersampling=1, blur=0.01)
    piece = EXAMPLES["leather"].pieces(1)
    shot = take(piece, camera, setup)
    whole = render_rectified(true_maps(piece, camera, setup), shot.setup)
    inner = slice(2, -2)
    np.testing.assert_allclose(
        shot.linear[inner, inner], whole.permute(1, 2, 0).numpy()[inner, inner], rtol=1e-3
    )


@pytest.mark.parametrize("name", ["leather", "granite", "rust", "tile"])
def test_exposure_clips_a_little_on_glossy_ones(name):
    photo = as_photo(EXAMPLES[name].take(PhoneCamera(width=256, height=192)), 0, name)
    assert 0.0 < photo.clipped_share < 0.03
    assert photo.radiometric and photo.flash_fired
    assert photo.pixels.max() <= 1.0 and np.isfinite(photo.pixels).all()


def test_noise_is_shot_and_read_noise():
    shot = take(
        _flat, PhoneCamera(width=128, height=96, full_well=1000.0, read_noise=5.0), FlashSetup()
    )
    error = expose(shot, 1) - shot.linear
    expected = np.sqrt(shot.linear.mean() / 1000.0 + 0.005**2)
    assert error.std() == pytest.approx(expected, rel=0.03)
    assert abs(error.mean()) < 3e-4


def test_true_maps_lie_on_the_plane_grid():
    """A detail of the truth and of the photograph are in one place, also when tilted."""
    example = EXAMPLES["granite"]
    camera = PhoneCamera(width=256, height=192)
    shot, truth = example.take(camera), example.truth(camera)
    assert truth.size == (256, 192)
    points = plane_points(0, 0, 256, 192, (256, 192), dtype=torch.float64)
    image = project(points, shot.setup).numpy()
    column = np.clip(np.round((image[0] + 1) * 128 - 0.5).astype(int), 0, 255)
    row = np.clip(np.round(96 - image[1] * 128 - 0.5).astype(int), 0, 191)
    photographed = shot.linear[row, column].mean(-1)
    rendered = render_rectified(truth, shot.setup).mean(0).numpy()
    inner = slice(8, -8)

    def agreement(dx):
        moved = np.roll(photographed, dx, axis=1)
        return np.corrcoef(moved[inner, inner].ravel(), rendered[inner, inner].ravel())[0, 1]

    assert agreement(0) > 0.8
    assert agreement(0) > max(agreement(2), agreement(-2)) + 0.1


def test_true_maps_are_of_the_piece_that_was_photographed():
    """Granite's grains are others at another fineness; its truth must be what the camera saw."""
    camera, example = PhoneCamera(width=240, height=180), EXAMPLES["granite"]
    shot = example.take(camera)
    seen, _ = rectify(as_photo(shot, 0, "granite"), shot.setup, camera.width)
    true = render_rectified(example.truth(camera).map(lambda m: m.float()), shot.setup)
    pictures = torch.stack([p.clamp_min(1e-3).log().mean(0).flatten() for p in (seen, true)])
    assert float(torch.corrcoef(pictures)[0, 1]) > 0.8  # the lens blurs; another piece has 0.74


SMALL = PhoneCamera(96, 72, supersampling=1)


def test_a_material_is_photographed_in_the_same_way_at_every_time_and_others_otherwise():
    rust, tile = (PhonePhotographs.of(EXAMPLES[name], SMALL) for name in ("rust", "tile"))
    again = PhonePhotographs.of(EXAMPLES["rust"], SMALL)
    assert (rust.phone, rust.hand, rust.tilt) == (again.phone, again.hand, again.tilt)
    assert rust.phone != tile.phone and rust.tilt != tile.tilt


def named(name, material=EXAMPLES["plaster"].material):
    return replace(EXAMPLES["plaster"], name=name, material=material)


def test_exposures_are_those_of_real_photographs():
    phones = [PhonePhotographs.of(named(f"plaster {number}"), SMALL).phone for number in range(400)]
    brightness = np.quantile([phone.brightness for phone in phones], (0.05, 0.5, 0.95))
    assert brightness == pytest.approx([0.075, 0.133, 0.236], rel=0.15)
    clipped = [phone.clipped for phone in phones]
    assert np.median(clipped) == pytest.approx(0.0, abs=1e-4) and max(clipped) <= 0.02


def test_from_further_away_slopes_stay_and_more_is_seen():
    pieces, asked = named("").pieces, []

    def spy(width, height, seed, texel_size):
        asked.append(texel_size)
        return pieces(seed)(width, height, texel_size)

    maps = PhonePhotographs.of(named("far", spy), SMALL).specimen.pieces(3)(32, 32, 0.01)
    (texel,) = asked
    assert 0.5**0.5 <= texel / 0.01 <= 2.0**0.5 and texel != 0.01
    assert maps.texel_size == 0.01
    assert torch.allclose(maps.normal, pieces(3)(32, 32, texel).normal, atol=1e-6)


def test_photographs_are_taken_once_and_their_truth_is_kept(tmp_path):
    held = PhonePhotographs.of(EXAMPLES["plaster"], SMALL)
    paths, setup = held.take(2, tmp_path)
    assert [path.name for path in paths] == ["plaster_0.dng", "plaster_1.dng"]
    written = paths[0].stat().st_mtime_ns
    again, same = held.take(2, tmp_path)
    assert again == paths and same == setup and paths[0].stat().st_mtime_ns == written
    more, _ = held.take(3, tmp_path)
    assert len(more) == 3 and all(path.exists() for path in more)
    mean = float(load_photo(paths[0], noise=False).pixels.mean())
    assert mean <= held.phone.brightness * 1.1
    assert setup.tilt == held.tilt and setup.intensity[0] > 0.0
