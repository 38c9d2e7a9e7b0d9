"""The one sRGB curve, colours of other primaries, and one luminance in the package."""

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import matcap
from matcap.files.rec709 import LUMINANCE, REC709, rec709_from
from matcap.files.srgb import (
    srgb_decode,
    srgb_decode_tensor,
    srgb_encode,
    srgb_encode_tensor,
    srgb_picture,
    srgb_slope,
)

D65 = (0.3127, 0.3290)
P3 = (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *D65)
REC2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *D65)
# ITU-R BT.2087-0 gives the inverse; BT.2407-0, section 2 this.
REC2020_TO_709 = [
    [1.6605, -0.5876, -0.0728],
    [-0.1246, 1.1329, -0.0083],
    [-0.0182, -0.1006, 1.1187],
]
ACES_AP1 = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)


def test_rec2020_as_published():
    np.testing.assert_allclose(rec709_from(REC2020), REC2020_TO_709, atol=2e-4)


@pytest.mark.parametrize("primaries", [P3, REC2020, ACES_AP1])
def test_white_stays_white_whatever_the_file_calls_white(primaries):
    np.testing.assert_allclose(rec709_from(primaries) @ np.ones(3), 1.0, atol=1e-12)


def test_rec709_itself_and_what_rounding_makes_of_it_need_no_matrix():
    assert rec709_from(REC709) is None
    assert rec709_from(np.round(np.array(REC709) + 4e-5, 4)) is None
    assert rec709_from(P3) is not None


def test_tristimulus_values_are_relative_to_d65():
    matrix = rec709_from((1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3))
    np.testing.assert_allclose(matrix @ [0.9505, 1.0, 1.0890], 1.0, atol=1e-3)
    # IEC 61966-2-1, annex F.
    np.testing.assert_allclose(matrix[0], [3.2406, -1.5372, -0.4986], atol=2e-3)


def test_luminance_is_the_second_row_of_the_way_to_xyz():
    to_xyz = np.linalg.inv(rec709_from((1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3)))
    np.testing.assert_allclose(to_xyz[1], LUMINANCE, atol=1e-4)


@pytest.mark.parametrize(
    "primaries",
    [
        (0.64, 0.33) * 3 + D65,
        (*REC709[:6], 0.3, 0.0),
        (float("nan"), *REC709[1:]),
        REC709[:6],
    ],
)
def test_what_is_no_basis_is_refused(primaries):
    with pytest.raises(ValueError, match="primaries|white"):
        rec709_from(primaries)


def test_no_other_file_has_its_own_luminance_or_srgb_curve():
    root = Path(matcap.__file__).parent
    for number, homes in (
        ("0.7152, 0.0722", {"files/rec709.py"}),
        ("1.055", {"files/srgb.py"}),
    ):
        found = {
            file.relative_to(root).as_posix()
            for file in root.rglob("*.py")
            if number in file.read_text(encoding="utf-8")
        }
        assert found == homes


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
