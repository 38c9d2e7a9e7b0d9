"""The alignment branch: what mirroring does to a tilt, and the sign convention."""

import pytest
import torch

from matcap.flash.geometry import FlashSetup, setup_rotation
from matcap.lab.train.align import Tilted, evaluate_alignment, mirror, train_alignment
from matcap.space.alignment import Alignment
from matcap.space.encoder import PICTURE_CHANNELS


@pytest.mark.parametrize("along_x, along_y", [(True, False), (False, True), (True, True)])
def test_a_mirrored_plane_leans_the_mirrored_way(along_x, along_y):
    """R' = M R M about the mirrors M; its normal is the mirrored normal."""
    tilt = torch.tensor([[0.12, -0.2]])
    _, found = mirror(torch.zeros(1, PICTURE_CHANNELS, 4, 4), tilt, along_x, along_y)
    flip = torch.diag(torch.tensor([-1.0 if along_x else 1.0, -1.0 if along_y else 1.0, 1.0]))
    before = setup_rotation(FlashSetup(tilt=tuple(tilt[0].tolist()))).float()
    after = setup_rotation(FlashSetup(tilt=tuple(found[0].tolist()))).float()
    torch.testing.assert_close(after, flip @ before @ flip)


def test_mirrored_coordinates_still_say_where_a_texel_lies():
    u = torch.tensor([-1.0, 0.0, 1.0]).expand(2, 3)
    v = torch.tensor([[0.5], [-0.5]]).expand(2, 3)
    picture = torch.stack([torch.zeros(2, 3)] * 3 + [u, v])[None]
    found, _ = mirror(picture, torch.zeros(1, 2), True, True)
    torch.testing.assert_close(found[0, 3], u)
    torch.testing.assert_close(found[0, 4], v)


def test_it_learns_which_way_a_ramp_leans():
    """Brighter above means the upper edge is nearer: positive tilt_x."""
    generator = torch.Generator().manual_seed(0)
    tilt = 0.2 * (2 * torch.rand(64, 2, generator=generator) - 1)
    u = torch.linspace(-1, 1, 64).expand(48, 64)
    v = torch.linspace(0.75, -0.75, 48)[:, None].expand(48, 64)
    ramps = 3.0 * (tilt[:, :1, None] * v - tilt[:, 1:, None] * u)
    pictures = torch.stack([*([ramps] * 3), u.expand(64, 48, 64), v.expand(64, 48, 64)], dim=1)
    pool = Tilted(pictures, torch.full((64,), 60.0), tilt)
    network = train_alignment(pool, 40, batch=8)
    assert isinstance(network, Alignment)
    assert float(evaluate_alignment(network, pool).abs().mean()) < 3.5  # of about 5.7 untrained
