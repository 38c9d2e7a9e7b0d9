"""Descriptors and their distance: zero for the same, small for alike, large for unlike."""

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F

from matcap.statistics.compare import (
    QUANTILES,
    Descriptor,
    Weights,
    _quantiles,
    describe,
    distance,
)
from matcap.statistics.encoding import fit_encoding
from matcap.statistics.filterbank import FilterBank, FilterBankConfig

BANK = FilterBank(FilterBankConfig(sizes=(5,), filters=16, levels=3))
KINDS = ("gram", "cross", "spectrum", "histogram", "mean")


def texture(scale, *, seed=0, side=160, contrast=0.3):
    """(1, 3, side, side) radiance: log-normal blotches `scale` texels wide."""
    generator = torch.Generator().manual_seed(seed)
    wide = torch.randn(1, 3, side + scale, side + scale, generator=generator)
    smooth = F.avg_pool2d(wide, scale, 1)[..., :side, :side] * scale
    return 0.2 * torch.exp(contrast * smooth)


def encoding_of(linear):
    return fit_encoding(linear[0], torch.ones(linear.shape[-2:], dtype=torch.bool))


ENCODING = encoding_of(texture(4))


def described(linear):
    return describe(linear, ENCODING, BANK)


def apart(first, second, weights=None):
    return float(distance(described(first), described(second), weights or Weights()))


def test_a_window_is_at_no_distance_from_itself():
    assert apart(texture(4), texture(4)) == 0


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_alone_sees_what_it_is_there_for(kind):
    only = Weights(**{name: float(name == kind) for name in KINDS})
    base = texture(4)
    changed = {
        "gram": texture(8),
        "cross": texture(8),
        "spectrum": texture(8),
        "histogram": texture(4, contrast=0.6),
        "mean": 1.5 * base,
    }[kind]
    assert apart(changed, base, only) > 2.0 * max(apart(texture(4, seed=1), base, only), 0.01)


def test_other_pieces_of_a_texture_are_nearer_than_other_textures():
    same = apart(texture(4, seed=1), texture(4))
    for other in (texture(2), texture(8), texture(4, contrast=0.1), texture(4).flip(1) * 2.0):
        assert apart(other, texture(4)) > 1.15 * same


def patches(seed):
    """Sharp-edged patches about 12 texels wide, as what pooling by 4 keeps of them and the rest."""
    smooth = texture(12, seed=seed).log()
    sharp = 0.8 * torch.sign(smooth - smooth.mean(dim=(2, 3), keepdim=True))
    coarse = F.interpolate(F.avg_pool2d(sharp, 4), scale_factor=4, mode="bilinear")
    return coarse, sharp - coarse


def test_fine_structure_that_has_left_its_coarse_structure_is_seen_across_levels():
    def picture(seed, moved=0):
        coarse, fine = patches(seed)
        return 0.2 * torch.exp(coarse + fine.roll(moved, dims=2))

    none = Weights(gram=0.0, cross=0.0, spectrum=0.0, histogram=0.0, mean=0.0)
    ratios = {}
    for kind in ("cross", "spectrum"):
        only = replace(none, **{kind: 1.0})
        alike = apart(picture(1), picture(0), only)
        ratios[kind] = apart(picture(1, moved=80), picture(0), only) / alike
    assert ratios["cross"] > 1.25
    assert ratios["spectrum"] < 1.1


def test_windows_are_described_one_by_one():
    both = described(torch.cat([texture(4), texture(8)]))
    second = described(texture(8))
    assert distance(both.select([1]), second, Weights()).max() < 1e-5
    joined = Descriptor.joined([both.select([0]), both.select([1])])
    assert distance(joined, both, Weights()).max() == 0


def test_half_the_exposure_is_the_same_texture_but_for_its_mean():
    base = texture(4)
    full, half = encoding_of(base), encoding_of(0.5 * base)
    assert half.median == pytest.approx(0.5 * full.median)
    assert torch.allclose(half.matrix, full.matrix, atol=1e-4)
    found = describe(0.5 * base, half, BANK)
    assert float(distance(found, describe(base, full, BANK), Weights())) < 1e-3


def test_turned_by_a_right_angle_distribution_and_means_stay():
    base, turned = texture(4), torch.rot90(texture(4), 1, (2, 3))
    assert apart(turned, base, Weights(gram=0.0, cross=0.0, spectrum=0.0)) < 1e-5
    assert apart(turned, base, Weights(cross=0.0, spectrum=0.0, histogram=0.0, mean=0.0)) < 0.2


def test_the_encoding_gives_texture_unit_variance_and_no_correlation():
    generator = torch.Generator().manual_seed(0)
    grey = torch.randn(1, 96, 96, generator=generator)
    own = torch.randn(3, 96, 96, generator=generator)
    linear = 0.2 * torch.exp(0.3 * grey + 0.15 * own)
    encoded = encoding_of(linear[None])(linear[None])[0].flatten(1)
    assert torch.allclose(torch.cov(encoded), torch.eye(3), atol=0.1)


def test_the_gradient_points_the_way_the_distance_falls():
    target = described(texture(4))
    linear = texture(5, seed=2).requires_grad_()
    before = distance(described(linear), target, Weights()).sum()
    before.backward()
    slope = linear.grad
    step = 1e-4 * slope / slope.norm()
    up = distance(described(linear.detach() + step), target, Weights()).sum()
    down = distance(described(linear.detach() - step), target, Weights()).sum()
    assert float((up - down) / 2e-4) == pytest.approx(float(slope.norm()), rel=0.05)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_quantiles_are_those_of_sorted_colours_with_or_without_a_gradient(dtype):
    generator = torch.Generator().manual_seed(1)
    level = torch.randn(2, 3, 40, 40, generator=generator).to(dtype)
    level[0, 0, 0, :2] = torch.tensor([0.0, -0.0])
    centred = level.flatten(2) - level.flatten(2).mean(dim=2, keepdim=True)
    chunk = centred.shape[2] // QUANTILES
    expected = centred.sort(dim=2).values[..., : chunk * QUANTILES]
    expected = expected.unflatten(2, (QUANTILES, chunk)).mean(dim=3)
    for needed in (False, True):
        assert torch.equal(_quantiles(level.clone().requires_grad_(needed)), expected)
