"""A decoder that comes without cells, as the prior's does, learns to read them."""

import torch

from matcap.field.plane import Rectangle
from matcap.space.decoder import CODE_SIZE, DEPTH, Decoder, DecoderConfig, with_cells
from matcap.space.lattice_channels import CELL_CHANNELS, WAVE_CHANNELS
from matcap.space.patch import Patch
from matcap.space.random_field import RandomField, random_field
from matcap.space.tuning.start import reading_cells
from matcap.statistics.lattice import Wave

CONFIG = DecoderConfig(noise_channels=2, widths=(4, 4, 6, 6, 6))
WAVES = (Wave(1 / 23.0, 0.0), Wave(0.0, 1 / 19.0))
CODE = torch.zeros(CODE_SIZE)


def a_field():
    return random_field(
        Patch(4, Rectangle(0, 0, 64, 64)), 2, WAVES, levels=DEPTH, cells=CELL_CHANNELS
    )


def without_cells(field):
    return RandomField(field.noise, tuple(w[:, :WAVE_CHANNELS] for w in field.waves))


def test_where_cells_say_nothing_it_is_the_decoder_that_it_was():
    decoder = Decoder(CONFIG)
    wider = reading_cells(decoder, 0)
    silent = RandomField(
        a_field().noise,
        tuple(
            torch.cat([w[:, :WAVE_CHANNELS], 0.0 * w[:, WAVE_CHANNELS:]], 1)
            for w in a_field().waves
        ),
    )
    with torch.no_grad():
        expected = decoder(without_cells(a_field()), CODE)
        assert torch.allclose(wider(silent, CODE), expected, atol=1e-4)
        assert not torch.allclose(wider(a_field(), CODE), expected, atol=0.05)


def test_the_weights_for_cells_are_drawn_by_the_seed_and_learn():
    decoder = Decoder(CONFIG)
    first, again, other = (reading_cells(decoder, seed).state_dict() for seed in (1, 1, 2))
    name = "up.0.0.convolution.weight"
    assert torch.equal(first[name], again[name])
    assert not torch.equal(first[name], other[name])
    wider = reading_cells(decoder, 1)
    wider(a_field(), CODE)[:, 0].square().mean().backward()
    slope = wider.up[3][0].convolution.weight.grad[:, -CELL_CHANNELS:]
    assert float(slope.abs().max()) > 0.0


def test_the_given_decoders_are_left_as_they_are():
    decoder, other = Decoder(CONFIG), reading_cells(Decoder(CONFIG), 3)
    before = {name: value.clone() for name, value in other.state_dict().items()}
    mixed = with_cells(decoder, other)
    with torch.no_grad():
        mixed.head.convolution.weight.add_(1.0)
    assert all(torch.equal(value, before[name]) for name, value in other.state_dict().items())
    assert decoder.config.cells == 0
