"""The one sRGB curve, in both forms."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from matcap.files.srgb import (
    srgb_decode,
    srgb_decode_tensor,
    srgb_encode,
    srgb_encode_tensor,
    srgb_picture,
    srgb_slope,
)

# (linear light, code value): black, the knee, middle grey, half the light, white.
WORKED = [(0.0, 0.0), (0.0031308, 0.04045), (0.214041, 0.5), (0.5, 0.735357), (1.0, 1.0)]


def encoded(light: float) -> tuple[float, float]:
    """By NumPy and by PyTorch."""
    tensor = torch.tensor(light, dtype=torch.float64)
    return float(srgb_encode(np.array(light))), float(srgb_encode_tensor(tensor))


def decoded(code: float) -> tuple[float, float]:
    tensor = torch.tensor(code, dtype=torch.float64)
    return float(srgb_decode(np.array(code))), float(srgb_decode_tensor(tensor))


@pytest.mark.parametrize(("light", "code"), WORKED)
def test_worked_values(light, code):
    assert encoded(light) == pytest.approx((code, code), abs=1e-6)
    assert decoded(code) == pytest.approx((light, light), abs=1e-6)


@given(st.floats(-0.5, 4.0))
def test_there_and_back(light):
    code = encoded(light)
    assert code[0] == pytest.approx(code[1], rel=1e-14, abs=1e-300)
    assert decoded(code[0]) == pytest.approx((light, light), abs=1e-7)


@given(st.floats(0.0, 1.0, allow_subnormal=False))
def test_there_and_back_keeps_what_is_dark(light):
    assert decoded(encoded(light)[0]) == pytest.approx((light, light), rel=1e-12, abs=0.0)


@pytest.mark.parametrize("knee", [0.0, 0.0031308])
def test_it_is_joined_at_the_knee_and_its_slope_is_bounded(knee):
    step = 1e-9
    before, at, after = srgb_encode(np.array([knee - step, knee, knee + step]))
    assert at - before == pytest.approx(12.92 * step, rel=2e-2, abs=4e-8)
    assert after - at == pytest.approx(12.92 * step, rel=2e-2, abs=4e-8)
    assert np.isfinite(srgb_encode(np.array([-1.0, 0.0, 1e-320]))).all()


@pytest.mark.parametrize("curve", [srgb_encode_tensor, srgb_decode_tensor])
def test_gradients_on_both_sides_of_the_knee(curve):
    values = torch.tensor([-0.2, 0.0, 1e-3, 0.02, 0.06, 0.5, 2.0], dtype=torch.float64)
    assert torch.autograd.gradcheck(curve, values.requires_grad_())


def test_a_picture_is_clipped():
    linear = np.array([-1.0, 0.0, 0.214041, 1.0, 2.0], dtype=np.float32)
    found = srgb_picture(linear)
    assert found.dtype == np.float32
    assert found == pytest.approx([0.0, 0.0, 0.5, 1.0, 1.0], abs=1e-6)


@pytest.mark.parametrize("light", [0.0, 0.001, 0.01, 0.2, 1.0, 3.0])
def test_its_slope_is_that_of_the_curve(light):
    at = np.array([light - 1e-6, light + 1e-6])
    rise = np.diff(srgb_encode(at))[0] / 2e-6
    assert srgb_slope(np.array(light)) == pytest.approx(rise, rel=1e-4)
    assert srgb_slope(np.array([light], np.float32)).dtype == np.float32
