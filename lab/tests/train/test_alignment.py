"""The alignment branch's training: mirrored photographs, what files have, and that it learns."""

import math

import numpy as np
import pytest
import torch

from matcap.flash.alignment import tilt_measurement
from matcap.flash.geometry import FlashSetup, setup_rotation
from matcap_lab.simulate.kinds import RandomKind
from matcap_lab.train.alignment import (
    HELD_OUT_KINDS,
    UNSEEN,
    Tilted,
    develop,
    likelihood_loss,
    material_of,
    mirror,
    take_tilted,
    tilted_photo,
    train_alignment,
)


def ramps(count):
    """Pictures brighter where the plane is nearer: positive tilt_x above, positive tilt_y left.

    By far more than a flash that points aside makes them.
    """
    tilt = 0.2 * (2 * torch.rand(count, 2, generator=torch.Generator().manual_seed(0)) - 1)
    u = torch.linspace(-1, 1, 64).expand(48, 64)
    v = torch.linspace(0.75, -0.75, 48)[:, None].expand(48, 64)
    light = (15.0 * (tilt[:, :1, None] * v - tilt[:, 1:, None] * u)).exp()
    return Tilted(
        light[:, None].expand(-1, 3, -1, -1).half(),
        torch.full((count,), 60.0),
        torch.zeros(count, 2),
        tilt,
    )


def test_a_mirrored_plane_leans_the_mirrored_way_and_its_flash_changes_sides():
    """R' = M R M about the mirror M; its normal is the mirrored normal."""
    taken = Tilted(
        torch.arange(4.0).expand(1, 3, 2, 4),
        torch.tensor([60.0]),
        torch.tensor([[0.1, 0.2]]),
        torch.tensor([[0.12, -0.2]]),
    )
    found = mirror(taken)
    flip = torch.diag(torch.tensor([-1.0, 1.0, 1.0]))
    before = setup_rotation(FlashSetup(tilt=tuple(taken.tilt[0].tolist()))).float()
    after = setup_rotation(FlashSetup(tilt=tuple(found.tilt[0].tolist()))).float()
    torch.testing.assert_close(after, flip @ before @ flip)
    torch.testing.assert_close(found.offset, torch.tensor([[-0.1, 0.2]]))
    assert found.radiance[0, 0, 0].tolist() == [3.0, 2.0, 1.0, 0.0]


def test_it_learns_which_way_a_ramp_leans():
    """Brighter above means the upper edge is nearer: positive tilt_x."""
    pool = ramps(64)
    network = train_alignment(pool, 40, batch=8)
    pictures, result = develop(pool, np.random.default_rng(1), radiometric=True).shown()
    for _ in range(2):  # and a step more, on from it, forgets nothing
        with torch.no_grad():
            mean, _ = network(pictures, result)
        error = torch.rad2deg((mean - pool.tilt).abs().mean())
        assert float(error) < 3.5  # of about 5.7 untrained
        network = train_alignment(pool, 1, batch=8, start=network)


def test_the_loss_is_least_at_the_errors_own_deviation():
    """Of a mean that is off by 0.05, a standard deviation of 0.05 costs least."""
    off = torch.full((1, 2), 0.05)
    stds = [0.01, 0.03, 0.05, 0.08, 0.2]

    def slope(std):
        log_std = torch.full((1, 2), math.log(std), requires_grad=True)
        likelihood_loss(off, log_std, torch.zeros(1, 2)).backward()
        return float(log_std.grad.sum())

    assert [np.sign(round(slope(std), 6)) for std in stds] == [-1, -1, 0, 1, 1]


@pytest.mark.parametrize("radiometric", [True, False])
def test_a_file_has_a_clip_level_and_says_what_it_is(radiometric):
    done = develop(ramps(8), np.random.default_rng(0), radiometric)
    assert float(done.linear.max()) <= 1.0 and float(done.linear.min()) >= 0.0
    assert done.radiometric.tolist() == [radiometric] * 8
    assert done.known.all() or not radiometric  # a RAW knows its field of view
    assert set(done.fov[~done.known].tolist()) <= {45.0}


def test_what_it_is_judged_by_is_never_trained_on():
    trained = [material_of(seed) for seed in range(60)]
    judged = [material_of(UNSEEN + seed) for seed in range(20)]
    kinds = [{m.kind for m in some if isinstance(m, RandomKind)} for some in (trained, judged)]
    assert not kinds[0] & set(HELD_OUT_KINDS) and kinds[1] and kinds[1] <= set(HELD_OUT_KINDS)


def test_shots_of_one_material_differ_in_tilt_and_are_finite():
    taken = take_tilted(3, 96, 2)
    assert taken.radiance.shape == (2, 3, 72, 96) and bool(torch.isfinite(taken.radiance).all())
    assert not torch.equal(taken.tilt[0], taken.tilt[1])
    assert float(taken.tilt.abs().max()) <= math.radians(15.0) + 1e-6


# The alignment branch: what it says of photographs, how sure it is, and its file.


@pytest.fixture(scope="module")
def measured():
    """What it says of forty photographs of held-out kinds, half of them RAW, and the truth."""
    shots = [tilted_photo(UNSEEN + 500 + n, 320, radiometric=bool(n % 2)) for n in range(40)]
    return [(tilt_measurement(photo), truth) for photo, truth in shots]


def test_it_is_nearer_than_square_and_leans_the_right_way(measured):
    """Both angles: a sign turned in either would make errors twice as large as saying nothing."""
    for axis in (0, 1):
        errors = [abs(math.degrees(found.mean[axis] - true[axis])) for found, true in measured]
        nothing = [abs(math.degrees(true[axis])) for _, true in measured]
        assert np.mean(errors) < 0.45 * np.mean(nothing)


def test_it_knows_how_far_it_is_off(measured):
    """Errors over their predicted deviations are about normal; and it is not always as sure."""
    scores = np.array([(f.mean[a] - t[a]) / f.std[a] for f, t in measured for a in (0, 1)])
    assert 0.5 < np.sqrt(np.mean(scores**2)) < 2.0
    deviations = [found.std[0] for found, _ in measured]
    assert max(deviations) > 1.3 * min(deviations)
