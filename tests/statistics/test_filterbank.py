"""Random filters, their pyramid, and Gram matrices with their gradient."""

import pytest
import torch
import torch.nn.functional as F

from matcap.statistics.filterbank import FilterBank, FilterBankConfig, pyramid
from matcap.statistics.gram import gram, moments

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


def test_the_seed_makes_the_filters_and_nothing_else_does():
    torch.manual_seed(1)
    first = FilterBank(SMALL)
    torch.manual_seed(2)
    again = FilterBank(SMALL)
    other = FilterBank(FilterBankConfig(sizes=(3, 5), filters=4, levels=3, seed=5))
    for a, b, c in zip(first.weights, again.weights, other.weights, strict=True):
        assert torch.equal(a, b)
        assert not torch.equal(a, c)


def test_a_constant_picture_has_no_response():
    features = FilterBank(SMALL).features(torch.full((1, 3, 20, 24), 3.0))
    assert features.shape == (1, 8, 16, 20)
    assert features.abs().max() < 1e-4


def test_nothing_is_invented_at_the_border():
    bank, whole = FilterBank(SMALL), picture(24, 28)
    inner = bank.features(whole[..., 3:-2, 4:-1])
    assert torch.allclose(inner, bank.features(whole)[..., 3:-2, 4:-1], atol=1e-5)


def test_responses_are_rectified_and_grow_with_contrast():
    bank, image = FilterBank(SMALL), picture(20, 20)
    features = bank.features(image)
    assert features.min() == 0
    assert (features > 0).float().mean() > 0.3
    assert torch.allclose(bank.features(3.0 * image), 3.0 * features, atol=1e-4)


def test_gradients_are_the_derivatives():
    bank = FilterBank(FilterBankConfig(sizes=(3,), filters=2))
    image = picture(6, 6, dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(bank.features, (image,))


@pytest.mark.parametrize(("side", "levels"), [(160, 4), (64, 3), (31, 1), (16, 1)])
def test_a_pyramid_halves_keeps_the_mean_and_stops_in_time(side, levels):
    image = picture(side, side)
    found = pyramid(image, 5)
    assert [level.shape[-1] for level in found] == [side >> k for k in range(levels)]
    if side % 8 == 0:
        for level in found:
            assert torch.allclose(level.mean((2, 3)), image.mean((2, 3)), atol=1e-5)


def plain(features):
    """What gram() is a fast form of."""
    ones = torch.ones_like(features[:, :1])
    flat = torch.cat([features, ones], dim=1).flatten(2)
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
    assert found.dtype == torch.float32
    assert torch.allclose(found, plain(given), atol=1e-5)
    assert torch.allclose(found[:, -1, :-1], given.mean((2, 3)), atol=1e-6)


def test_gradient_is_the_plain_sums():
    weights = features((2, 6, 6), seed=1)  # not symmetric: a gradient that assumes it would fail
    given = features((2, 5, 6, 7)).requires_grad_()
    (gram(given) * weights).sum().backward()
    reference = given.detach().double().requires_grad_()
    (plain(reference) * weights).sum().backward()
    assert torch.allclose(given.grad.double(), reference.grad, atol=1e-6)


def test_half_precision_comes_back_as_float32():
    given = features((1, 4, 8, 8))
    found = gram(given.bfloat16())
    assert found.dtype == torch.float32
    assert (found - plain(given)).abs().max() < 0.03


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
