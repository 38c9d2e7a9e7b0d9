"""The alignment branch and perspective."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from simulated.materials import piece
from simulated.photographs import PhoneCamera, as_photo, take

from matcap.errors import MatcapError
from matcap.flash.alignment import (
    SHIPPED,
    Alignment,
    convergence,
    load_alignment,
    save_alignment,
    tilt_measurement,
)
from matcap.flash.geometry import FlashSetup, setup_rotation

# The alignment branch: what it says of photographs, how sure it is, and its file.


def tilted_photo(seed, tilt=(0.0, 0.0), width=320):
    """Leather or granite, as RAW, its camera tilted by radians."""
    phone = PhoneCamera(width=width, height=width * 3 // 4, supersampling=1)
    setup = FlashSetup(offset=(0.03, 0.12, 0.0), tilt=tilt)
    return as_photo(take(piece(("leather", "granite")[seed % 2], seed), phone, setup), 1, "tilted")


@pytest.mark.parametrize("axis", [0, 1])
def test_the_tilt_has_the_right_sign_and_a_varying_deviation(axis):
    """A sign turned in either angle would make errors twice as large as saying nothing."""
    errors, deviations = [], []
    for seed, angle in enumerate((-0.2, -0.15, 0.15, 0.2)):
        found = tilt_measurement(tilted_photo(seed, (angle, 0.0) if axis == 0 else (0.0, angle)))
        errors.append(abs(found.mean[axis] - angle))
        deviations.append(found.std[axis])
    assert np.mean(errors) < 0.175 and min(deviations) > 0.0 and max(deviations) > min(deviations)


def test_tilt_is_independent_of_exposure_and_of_left_out_pixels():
    photo = tilted_photo(3)
    whole = tilt_measurement(photo)
    darker = tilt_measurement(replace(photo, pixels=0.5 * photo.pixels))
    assert darker.mean == pytest.approx(whole.mean, abs=0.01)
    out = np.zeros(photo.pixels.shape[:2], bool)
    out[:40, :60] = True
    painted = photo.pixels.copy()
    painted[out] = 1.0
    masked = tilt_measurement(replace(photo, left_out=out))
    assert tilt_measurement(replace(photo, left_out=out, pixels=painted)) == masked


def test_weights_are_read_back_and_damage_is_named(tmp_path):
    torch.manual_seed(0)
    branch = Alignment().eval()
    save_alignment(tmp_path / "branch.safetensors", branch)
    again = load_alignment(tmp_path / "branch.safetensors")
    for name, value in branch.state_dict().items():
        assert torch.equal(again.state_dict()[name], value.half().float())
    save_file({"x": torch.zeros(2)}, tmp_path / "other.safetensors")
    for name, why in (("other", "not an alignment branch"), ("absent", "cannot be read")):
        with pytest.raises(MatcapError, match=why):
            load_alignment(tmp_path / f"{name}.safetensors")
    assert load_alignment(SHIPPED) is not None


# Tilt from the perspective of a texture, on planes photographed by exact geometry.


FOV = 60.0


def plane(tilt, texture, width=512):
    """A picture of a plane tilted by `tilt` degrees: texture(x, y) of its points, unlit."""
    setup = FlashSetup(fov=FOV, tilt=tuple(math.radians(angle) for angle in tilt))
    rotation = setup_rotation(setup).numpy()
    u, v = np.meshgrid(
        (2 * np.arange(width) + 1 - width) / width,
        (3 * width / 4 - 1 - 2 * np.arange(width * 3 // 4)) / width,
    )
    eye = np.array([0.0, 0.0, setup.distance])
    rays = np.stack([u, v, np.zeros_like(u)], axis=-1) - eye
    normal = rotation[:, 2]
    hit = eye + rays * (-(eye @ normal) / (rays @ normal))[..., None]
    shown = texture(hit @ rotation[:, 0], hit @ rotation[:, 1])
    return np.repeat((0.3 + 0.1 * shown)[..., None], 3, axis=-1).astype(np.float32)


def check(x, y):
    return np.cos(90 * x + 20 * y) + np.cos(95 * y - 15 * x)


@pytest.mark.parametrize("tilt", [(6.0, 0.0), (-4.0, 7.0), (0.0, 0.0)])
def test_a_lattice_shows_its_tilt_to_half_a_degree(tilt):
    """With a sign turned, or slopes along the other axis, errors would be as large as the tilt."""
    tangents = convergence(plane(tilt, check)).numpy() / math.tan(math.radians(FOV / 2))
    for slope_x, slope_y, std_x, std_y in tangents:
        angles = math.degrees(math.atan(slope_y)), math.degrees(math.atan(-slope_x))
        assert angles == pytest.approx(tilt, abs=0.5)  # of first order in the tilt
        assert max(std_x, std_y) < math.radians(0.5)


def test_a_picture_without_texture_gives_no_tilt():
    found = convergence(np.full((96, 128, 3), 0.2, np.float32)).numpy()
    assert np.abs(found[:, :2]).max() == 0.0 and found[:, 2:].min() > 0.3


def test_uneven_brightness_alone_gives_no_tilt():
    """A flash beside the lens: tilt would be its only sign in a texture's brightness."""
    picture = plane((0.0, 0.0), check) * np.linspace(0.3, 1.0, 512, dtype=np.float32)[:, None]
    assert np.abs(convergence(picture).numpy()[:, :2]).max() < 0.01


@pytest.mark.parametrize("rows", [1, 2, 8, 15])
def test_a_narrow_strip_gives_no_tilt(rows):
    strip = np.random.default_rng(0).random((rows, 4096 if rows < 3 else 256, 3), np.float32)
    assert convergence(strip)[:, :2].abs().max() == 0.0 and convergence(strip)[:, 2:].min() > 0.3


def test_a_picture_that_is_not_finite_has_no_slope():
    picture = plane((0.0, 0.0), check).copy()
    picture[5, 7] = np.nan
    assert convergence(picture)[:, 2:].min() > 0.3
