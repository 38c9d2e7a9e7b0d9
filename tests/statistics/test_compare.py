"""Texture descriptors and distances."""

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F

from matcap.statistics.compare import (
    QUANTILES,
    Descriptor,
    FilterBank,
    FilterBankConfig,
    Weights,
    _quantiles,
    describe,
    distance,
    fit_encoding,
    gram,
    moments,
    pyramid,
)

# Descriptors and their distance: zero for the same, small for alike, large for unlike.

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


def test_the_distance_of_a_window_to_itself_is_zero():
    assert apart(texture(4), texture(4)) == 0


@pytest.mark.parametrize("kind", KINDS)
def test_each_statistic_alone_detects_its_own_difference(kind):
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


def test_two_windows_of_a_texture_are_nearer_than_two_textures():
    same = apart(texture(4, seed=1), texture(4))
    for other in (texture(2), texture(8), texture(4, contrast=0.1), texture(4).flip(1) * 2.0):
        assert apart(other, texture(4)) > 1.15 * same


def patches(seed):
    """Sharp-edged patches about 12 texels wide, as what pooling by 4 keeps of them and the rest."""
    smooth = texture(12, seed=seed).log()
    sharp = 0.8 * torch.sign(smooth - smooth.mean(dim=(2, 3), keepdim=True))
    coarse = F.interpolate(F.avg_pool2d(sharp, 4), scale_factor=4, mode="bilinear")
    return coarse, sharp - coarse


def test_statistics_across_levels_detect_shifted_fine_structure():
    def picture(seed, moved=0):
        coarse, fine = patches(seed)
        return 0.2 * torch.exp(coarse + fine.roll(moved, dims=2))

    none = Weights(gram=0.0, cross=0.0, spectrum=0.0, histogram=0.0, mean=0.0)
    ratios = {}
    for kind in ("cross", "spectrum"):
        only = replace(none, **{kind: 1.0})
        alike = apart(picture(1), picture(0), only)
        ratios[kind] = apart(picture(1, moved=80), picture(0), only) / alike
    assert ratios["cross"] > 1.25 and ratios["spectrum"] < 1.1


def test_windows_are_described_one_by_one():
    both = described(torch.cat([texture(4), texture(8)]))
    second = described(texture(8))
    assert distance(both.select([1]), second, Weights()).max() < 1e-5
    joined = Descriptor.joined([both.select([0]), both.select([1])])
    assert distance(joined, both, Weights()).max() == 0


def test_half_the_exposure_changes_the_mean_alone():
    base = texture(4)
    full, half = encoding_of(base), encoding_of(0.5 * base)
    assert half.median == pytest.approx(0.5 * full.median)
    assert torch.allclose(half.matrix, full.matrix, atol=1e-4)
    found = describe(0.5 * base, half, BANK)
    assert float(distance(found, describe(base, full, BANK), Weights())) < 1e-3


def test_rotation_by_90_degrees_keeps_distribution_and_means():
    base, turned = texture(4), torch.rot90(texture(4), 1, (2, 3))
    assert apart(turned, base, Weights(gram=0.0, cross=0.0, spectrum=0.0)) < 1e-5
    assert apart(turned, base, Weights(cross=0.0, spectrum=0.0, histogram=0.0, mean=0.0)) < 0.2


def test_the_encoding_gives_texture_unit_variance_and_no_correlation():
    generator = torch.Generator().manual_seed(0)
    grey = torch.randn(1, 96, 96, generator=generator)
    linear = 0.2 * torch.exp(0.3 * grey + 0.15 * torch.randn(3, 96, 96, generator=generator))
    encoded = encoding_of(linear[None])(linear[None])[0].flatten(1)
    assert torch.allclose(torch.cov(encoded), torch.eye(3), atol=0.1)


def test_the_distance_falls_against_its_gradient():
    target = described(texture(4))
    linear = texture(5, seed=2).requires_grad_()
    distance(described(linear), target, Weights()).sum().backward()
    slope = linear.grad
    step = 1e-4 * slope / slope.norm()
    up = distance(described(linear.detach() + step), target, Weights()).sum()
    down = distance(described(linear.detach() - step), target, Weights()).sum()
    assert float((up - down) / 2e-4) == pytest.approx(float(slope.norm()), rel=0.05)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_quantiles_are_those_of_sorted_colours_with_or_without_a_gradient(dtype):
    level = torch.randn(2, 3, 40, 40, generator=torch.Generator().manual_seed(1)).to(dtype)
    level[0, 0, 0, :2] = torch.tensor([0.0, -0.0])
    centred = level.flatten(2) - level.flatten(2).mean(dim=2, keepdim=True)
    chunk = centred.shape[2] // QUANTILES
    expected = centred.sort(dim=2).values[..., : chunk * QUANTILES]
    expected = expected.unflatten(2, (QUANTILES, chunk)).mean(dim=3)
    for needed in (False, True):
        assert torch.equal(_quantiles(level.clone().requires_grad_(needed)), expected)


# Random filters, their pyramid, and Gram matrices with their gradient.

SMALL = FilterBankConfig(sizes=(3, 5), filters=4, levels=3)


def picture(height, width, *, seed=0, dtype=torch.float32):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(1, 3, height, width, generator=generator, dtype=dtype)


def test_filters_have_zero_mean_and_unit_norm_and_differ():
    for weight in FilterBank(SMALL).weights:
        assert weight.sum(dim=(2, 3)).abs().max() < 1e-5
        assert torch.allclose(weight.flatten(1).norm(dim=1), torch.ones(4))
        flat = weight.flatten(1)
        assert (flat @ flat.T - torch.eye(4)).abs().max() < 0.9


def test_filters_depend_on_the_seed_alone():
    torch.manual_seed(1)
    first = FilterBank(SMALL)
    torch.manual_seed(2)
    again = FilterBank(SMALL)
    other = FilterBank(FilterBankConfig(sizes=(3, 5), filters=4, levels=3, seed=5))
    for a, b, c in zip(first.weights, again.weights, other.weights, strict=True):
        assert torch.equal(a, b) and not torch.equal(a, c)


def test_a_constant_picture_has_no_response():
    features = FilterBank(SMALL).features(torch.full((1, 3, 20, 24), 3.0))
    assert features.shape == (1, 8, 16, 20) and features.abs().max() < 1e-4


def test_borders_add_no_response():
    bank, whole = FilterBank(SMALL), picture(24, 28)
    inner = bank.features(whole[..., 3:-2, 4:-1])
    assert torch.allclose(inner, bank.features(whole)[..., 3:-2, 4:-1], atol=1e-5)


def test_responses_are_rectified_and_grow_with_contrast():
    bank, image = FilterBank(SMALL), picture(20, 20)
    features = bank.features(image)
    assert features.min() == 0 and (features > 0).float().mean() > 0.3
    assert torch.allclose(bank.features(3.0 * image), 3.0 * features, atol=1e-4)


def test_gradients_are_the_derivatives():
    bank = FilterBank(FilterBankConfig(sizes=(3,), filters=2))
    image = picture(6, 6, dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(bank.features, (image,))


@pytest.mark.parametrize(("side", "levels"), [(160, 4), (64, 3), (31, 1), (16, 1)])
def test_a_pyramid_halves_and_keeps_the_mean_down_to_the_least_size(side, levels):
    image = picture(side, side)
    found = pyramid(image, 5)
    assert [level.shape[-1] for level in found] == [side >> k for k in range(levels)]
    if side % 8 == 0:
        for level in found:
            assert torch.allclose(level.mean((2, 3)), image.mean((2, 3)), atol=1e-5)


def plain(features):
    """What gram() is a fast form of."""
    flat = torch.cat([features, torch.ones_like(features[:, :1])], dim=1).flatten(2)
    return torch.einsum("bin,bjn->bij", flat, flat) / flat.shape[2]


def covariance(fine, coarse):
    return moments([fine, coarse], crossed=True)[1][0]


def features(shape, *, seed=0):
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
@pytest.mark.parametrize("shape", [(2, 5, 7, 9), (1, 1, 1, 1), (3, 8, 1, 4)])
def test_second_moments_and_means(shape, layout):
    given = features(shape).contiguous(memory_format=layout)
    found = gram(given)
    assert found.dtype == torch.float32 and torch.allclose(found, plain(given), atol=1e-5)
    assert torch.allclose(found[:, -1, :-1], given.mean((2, 3)), atol=1e-6)


def test_the_gradient_equals_that_of_plain_sums():
    weights = features((2, 6, 6), seed=1)  # not symmetric: a gradient that assumes it would fail
    given = features((2, 5, 6, 7)).requires_grad_()
    (gram(given) * weights).sum().backward()
    reference = given.detach().double().requires_grad_()
    (plain(reference) * weights).sum().backward()
    assert torch.allclose(given.grad.double(), reference.grad, atol=1e-6)


def test_half_precision_returns_float32():
    given = features((1, 4, 8, 8))
    found = gram(given.bfloat16())
    assert found.dtype == torch.float32 and (found - plain(given)).abs().max() < 0.03


@pytest.mark.parametrize(
    ("fine", "coarse"), [((12, 16), (6, 8)), ((12, 16), (4, 6)), ((9, 11), (4, 3))]
)
def test_covariances_across_levels_are_those_of_the_middles_that_meet(fine, coarse):
    generator = torch.Generator().manual_seed(0)
    one = torch.randn(2, 3, *fine, generator=generator, dtype=torch.float64).requires_grad_()
    other = torch.randn(2, 5, *coarse, generator=generator, dtype=torch.float64).requires_grad_()
    halved = F.avg_pool2d(one, 2)
    height, width = (min(a, b) for a, b in zip(halved.shape[2:], coarse, strict=True))
    y, x = ((a - b) // 2 for a, b in zip(halved.shape[2:], (height, width), strict=True))
    v, u = ((a - b) // 2 for a, b in zip(coarse, (height, width), strict=True))
    a = halved[..., y : y + height, x : x + width].flatten(2)
    b = other[..., v : v + height, u : u + width].flatten(2)
    means = a.mean(2)[:, :, None] * b.mean(2)[:, None, :]
    expected = a @ b.transpose(1, 2) / (height * width) - means
    assert torch.allclose(covariance(one, other).double(), expected, atol=1e-6)
    weight = torch.randn(2, 3, 5, generator=generator)
    found = torch.autograd.grad((covariance(one, other) * weight).sum(), (one, other))
    wanted = torch.autograd.grad((expected * weight).sum(), (one, other))
    for slope, reference in zip(found, wanted, strict=True):
        assert torch.allclose(slope, reference, atol=1e-6)


def test_constant_features_have_no_covariance_and_a_finite_gradient():
    one = torch.full((1, 2, 8, 8), 3.0, requires_grad=True)
    found = covariance(one, torch.full((1, 2, 4, 4), 5.0))
    assert found.abs().max() < 1e-6
    found.sum().backward()
    assert bool(torch.isfinite(one.grad).all())
