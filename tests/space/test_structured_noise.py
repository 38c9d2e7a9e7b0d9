"""Structured noise: cells and streaks, the same wherever they are asked for."""

from dataclasses import replace

import pytest
import torch
from materials import a_material

from matcap.field.field import Field
from matcap.field.material import Material
from matcap.field.plane import Rectangle
from matcap.space.decoder import DecoderConfig
from matcap.space.noise import noise_field
from matcap.space.patch import Patch
from matcap.space.random_field import noise_of
from matcap.space.structured_noise import STRUCTURED_CHANNELS, structured_field
from matcap.space.tuned import TunedDecoder

CONFIG = DecoderConfig(
    noise_channels=2, widths=(4, 4, 4, 4, 4), structured_channels=STRUCTURED_CHANNELS
)


@pytest.fixture(scope="module")
def material():
    return a_material("grained", 2, CONFIG, across=1024)


@pytest.mark.parametrize("corner", [(0, 0), (-70, 2**31 - 40), (2**40 - 200, -(2**40) + 3)])
def test_any_rectangle_has_the_same_texels(corner):
    x, y = corner
    whole = structured_field(Patch(3, Rectangle(x, y, 150, 130)))
    part = structured_field(Patch(3, Rectangle(x + 37, y + 11, 60, 70)))
    assert torch.equal(whole[:, 11:81, 37:97], part)


@pytest.mark.parametrize("period", [(80, 144), (16, 16), (None, 48)])
def test_a_period_is_kept(period):
    across, down = (side or 0 for side in period)
    field = structured_field(Patch(3, Rectangle(-30, 9, 200, 200), period=period))
    moved = structured_field(Patch(3, Rectangle(-30 + across, 9 + down, 200, 200), period=period))
    assert torch.equal(field, moved)


def test_cells_go_on_across_a_period_s_border():
    number = structured_field(Patch(3, Rectangle(0, 0, 256, 192), period=(256, 192)))[7]
    for first, last in ((number[:, 0], number[:, -1]), (number[0], number[-1])):
        assert float((first == last).float().mean()) > 0.8


def test_a_period_may_be_as_long_as_the_plane():
    far = Patch(3, Rectangle(2**40 - 64, 0, 64, 32), period=(2**40, 2**40))
    beyond = structured_field(replace(far, area=Rectangle(-64, 0, 64, 32)))
    assert torch.equal(structured_field(far), beyond)


def test_mean_and_deviation_are_about_those_of_white_noise():
    field = torch.stack([structured_field(Patch(s, Rectangle(0, 0, 512, 512))) for s in range(6)])
    assert float(field.mean((0, 2, 3)).abs().max()) < 0.15
    assert float((field.std((0, 2, 3)) - 1.0).abs().max()) < 0.1


def test_realisations_and_lattices_are_independent():
    fields = [structured_field(Patch(s, Rectangle(0, 0, 512, 512))).flatten(1) for s in (1, 2)]
    result = torch.corrcoef(torch.cat(fields))
    cells, streaks = torch.arange(0, 8), torch.arange(8, 12)
    own = torch.cat([cells, streaks])
    assert float(result[own][:, own + STRUCTURED_CHANNELS].abs().max()) < 0.25
    apart = result[1:8:2, 1:8:2] - torch.eye(4)
    assert float(apart.abs().max()) < 0.25


def test_a_streak_is_long_one_way():
    """Neighbours along it are of one streak more often than neighbours across."""
    field = structured_field(Patch(3, Rectangle(0, 0, 256, 256)))
    for channel, along in ((8, 1), (9, 0), (10, 1), (11, 0)):
        same = [float((field[channel].diff(n=1, dim=axis) == 0).float().mean()) for axis in (0, 1)]
        assert same[along] > 0.9 and same[along] > same[1 - along]


def test_the_decoder_reads_them_beside_white_noise():
    patch = Patch(5, Rectangle(16, 32, 48, 32))
    noise = noise_of(patch, 2, STRUCTURED_CHANNELS)
    assert torch.equal(noise[:2], noise_field(patch, 2))
    assert torch.equal(noise[2:], structured_field(patch))


def test_a_material_of_structured_noise_is_endless(material):
    whole = Field(material, 3).read(-300, 40, 300, 90).stacked()
    part = Field(material, 3).read(-170, 70, 60, 50).stacked()
    assert torch.equal(whole[:, 30:80, 130:190], part)
    assert not torch.equal(part, Field(material, 4).read(-170, 70, 60, 50).stacked())


def test_its_file_comes_back(material, tmp_path):
    path = tmp_path / "grained.matcap"
    material.save(path)
    again = Material.load(path)
    assert again.part(TunedDecoder).decoder.config == CONFIG
    assert torch.equal(again.maps(48, 32).stacked(), material.maps(48, 32).stacked())
