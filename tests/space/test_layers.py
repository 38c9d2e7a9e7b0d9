"""A torus's border: the same numbers, and the same gradient, as circular padding's."""

import pytest
import torch
import torch.nn.functional as F

from matcap.space.layers import wrap


def padded(features: torch.Tensor) -> torch.Tensor:
    return F.pad(features, (1, 1, 1, 1), mode="circular")


@pytest.mark.parametrize("size", [(1, 1), (1, 5), (4, 3), (16, 16)])
@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
def test_it_is_circular_padding(size, layout):
    torch.manual_seed(1)
    features = torch.randn(2, 3, *size).contiguous(memory_format=layout).requires_grad_(True)
    weight = torch.randn(2, 3, size[0] + 2, size[1] + 2)
    assert torch.equal(wrap(features), padded(features))
    (found,) = torch.autograd.grad((wrap(features) * weight).sum(), features)
    (wanted,) = torch.autograd.grad((padded(features) * weight).sum(), features)
    torch.testing.assert_close(found, wanted)


def test_its_gradient_is_the_difference():
    features = torch.randn(1, 2, 3, 4, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(wrap, (features,))
