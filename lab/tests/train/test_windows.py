"""Augmentation keeps the geometry true: a turned photograph is the photograph of a turned scene."""

import numpy as np
import pytest
import torch
from small import SMALL

from matcap.brdf.maps import MapSet
from matcap.space.prior.base import base_of, fold
from matcap.statistics.lattice import Wave
from matcap_lab.train.step import Turn, cut, prepare, start_head

TURNS = [Turn(mirrored, quarters) for mirrored in (False, True) for quarters in range(4)]


@pytest.fixture(scope="module")
def source(pack):
    return prepare(pack.entries[-1], 64)


@pytest.mark.parametrize("turn", TURNS)
def test_a_vector_moves_as_the_picture_does(turn):
    """The brightest texel lies where its position vector was turned to."""
    picture = torch.zeros(9, 9)
    picture[1, 6] = 1.0
    row, column = divmod(int(turn.image(picture).argmax()), 9)
    found = turn.vector(torch.tensor([2.0, 3.0]))  # texel (6, 1) about the middle, y upwards
    assert (column - 4, 4 - row) == tuple(found.int().tolist())


@pytest.mark.parametrize("turn", TURNS)
def test_a_wave_moves_as_the_picture_does(turn):
    rows, columns = torch.meshgrid(torch.arange(32.0), torch.arange(32.0), indexing="ij")

    def stripes(wave: Wave) -> torch.Tensor:
        return torch.fft.fft2(torch.cos(2 * torch.pi * (wave.fx * columns + wave.fy * rows))).abs()

    wave = Wave(3 / 32, 5 / 32)
    picture = torch.cos(2 * torch.pi * (wave.fx * columns + wave.fy * rows))
    turned = torch.fft.fft2(turn.image(picture)).abs()
    torch.testing.assert_close(turned, stripes(turn.wave(wave)), atol=1e-2, rtol=0)


@pytest.mark.parametrize("turn", TURNS)
def test_a_flat_material_renders_the_same_turned(source, turn):
    """Points, lights and vignetting turn together: rendering and turning commute."""
    flat = torch.full((1, 1, 48, 48), 0.4)
    maps = MapSet(flat.expand(1, 3, -1, -1), 0.1 * flat, flat, 0.0 * flat, 2.0 / 1024)
    plain = cut(source, 48, 2, 1, Turn(), np.random.default_rng(1), augment=False)
    turned = cut(source, 48, 2, 1, turn, np.random.default_rng(1), augment=False)
    torch.testing.assert_close(turned.render(maps), turn.image(plain.render(maps)))
    torch.testing.assert_close(turned.linear, turn.image(plain.linear))


def test_colours_and_base_are_permuted_together(source):
    plain = cut(source, 48, 1, 1, Turn(), np.random.default_rng(4), augment=False)
    changed = cut(source, 48, 1, 1, Turn(), np.random.default_rng(4))
    ratio = (changed.linear / changed.linear.sum(1, keepdim=True)).mean((0, 2, 3))
    order = ratio.argsort()
    assert torch.equal(order, changed.base.mean[:3].argsort())
    assert torch.equal(order, changed.numbers[:3].argsort())
    assert not torch.equal(plain.numbers, changed.numbers)


def test_the_encoding_follows_the_permutation(source):
    """What is compared stays the same but for a white balance of at most 15 percent."""
    plain = cut(source, 48, 1, 1, Turn(), np.random.default_rng(4), augment=False)
    changed = cut(source, 48, 1, 1, Turn(), np.random.default_rng(4))
    found, wanted = changed.encoding(changed.linear), plain.encoding(plain.linear)
    moved = (found - wanted).std(dim=(2, 3))
    assert bool((moved < 0.1 * wanted.std(dim=(2, 3))).all())


def test_folding_the_base_changes_no_output(prior, pack):
    from matcap_lab.train.step import fields

    start_head(prior.decoder)
    base = base_of(pack.entries[0].coarse, torch.tensor([0.1, 0.2, 0.3]))
    field = fields(SMALL, [()], 32, 1, "cpu")
    code = torch.randn(64)
    with torch.no_grad():
        wanted = base.apply(prior.decoder(field, code))
        found = fold(prior.decoder, base)(field, code)
    torch.testing.assert_close(found, wanted, atol=1e-4, rtol=1e-4)
