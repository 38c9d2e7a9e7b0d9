"""Random filters and their pyramid."""

import pytest
import torch

from matcap.statistics.filterbank import FilterBank, FilterBankConfig, pyramid

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
