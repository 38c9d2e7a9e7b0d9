"""The reflectance over its whole domain: finite, right in float32, and differentiable at its edges.

Stated: float32 within 1e-5 of float64 from roughness 1e-4 to 1, and float64 within 1e-9 of the
formula evaluated with 50 digits wherever no clamp acts.
"""

import math

import mpmath
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from stable.reflectance import CASES, measured, measured_rendering

from matcap.brdf.cook_torrance import MIN_ROUGHNESS, cook_torrance, normalize
from matcap.brdf.maps import MapSet, normals_from_slopes
from matcap.flash.light import shade

DRAWS = 4000


@pytest.mark.parametrize("case", CASES)
def test_values_and_gradients_are_finite_and_float32_agrees_with_float64(case):
    found = measured(CASES[case](DRAWS, torch.Generator().manual_seed(1)))
    assert (found.draws, found.broken) == (DRAWS, 0), found.where
    # Where F0 is 0 and light and view coincide, Fresnel is (1 - l.h)^5 of a difference: faint.
    within = 1e-3 if case in ("both albedos 0", "F0 = 0") else 1e-5
    assert found.worst < min(within, 1e-4)
    assert found.worst_smooth < within


def test_rendering_is_finite_however_near_or_far_the_light():
    found = measured_rendering(DRAWS, torch.Generator().manual_seed(1))
    assert (found.draws, found.broken) == (DRAWS, 0)
    assert max(found.worst, found.worst_smooth) < 1e-4


def exact(diffuse, specular, roughness, normal, light, view):
    """The formula in the header of brdf/cook_torrance.py, with 50 digits; one colour."""
    with mpmath.workdps(50):
        n, l, v = ([mpmath.mpf(x) for x in vector] for vector in (normal, light, view))  # noqa: E741

        def dot(a, b):
            return mpmath.fsum(x * y for x, y in zip(a, b, strict=True))

        h = [a + b for a, b in zip(l, v, strict=True)]
        length = mpmath.sqrt(dot(h, h))
        h = [x / length for x in h]
        nl, nv, nh, lh = dot(n, l), dot(n, v), dot(n, h), dot(l, h)
        a2 = mpmath.mpf(roughness) ** 4
        cross2 = dot(n, n) * dot(h, h) - nh**2
        d = a2 / (mpmath.pi * (cross2 + nh**2 * a2) ** 2)
        root_v = mpmath.sqrt(nv**2 * (1 - a2) + a2)
        root_l = mpmath.sqrt(nl**2 * (1 - a2) + a2)
        visibility = mpmath.mpf(1) / 2 / (nl * root_v + nv * root_l)
        fresnel = specular + (1 - mpmath.mpf(specular)) * (1 - lh) ** 5
        return float(mpmath.mpf(diffuse) / mpmath.pi + d * visibility * fresnel)


def direction(cosine, around):
    sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
    return [sine * math.cos(around), sine * math.sin(around), cosine]


def column(vector):
    return torch.tensor(vector, dtype=torch.float64)[:, None, None]


def evaluated(diffuse, specular, roughness, normal, light, view, dtype=torch.float64):
    arguments = (
        column([diffuse] * 3), column([specular]), column([roughness]),
        column(normal), column(light), column(view),
    )  # fmt: skip
    return float(cook_torrance(*(a.to(dtype) for a in arguments))[0])


UP = [0.0, 0.0, 1.0]
share = st.floats(0.0, 1.0)
turn = st.floats(0.0, 2.0 * math.pi)


@given(
    diffuse=share, specular=share, roughness=st.floats(MIN_ROUGHNESS, 1.0),
    light=st.floats(1e-3, 1.0), view=st.floats(1e-3, 1.0), around=turn,
)  # fmt: skip
def test_float64_is_the_formula(diffuse, specular, roughness, light, view, around):
    given = (diffuse, specular, roughness, UP, direction(light, 0.0), direction(view, around))
    assert evaluated(*given) == pytest.approx(exact(*given), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("roughness", [1e-3, 3e-3, 0.03, 0.3])
@pytest.mark.parametrize("off", [0.0, 0.3, 1.0, 5.0])  # alphas from the mirrored direction
def test_no_digits_are_lost_at_the_peak(roughness, off):
    view = direction(0.6, 0.4)
    light = normalize(column([-view[0] + 2.0 * off * roughness**2, -view[1], view[2]]))
    light = light.flatten().float().double().tolist()  # what float32 is given
    view = column(view).flatten().float().double().tolist()
    given = (0.2, 0.04, roughness, UP, light, view)
    assert evaluated(*given) == pytest.approx(exact(*given), rel=1e-8)
    assert evaluated(*given, dtype=torch.float32) == pytest.approx(exact(*given), rel=1e-5)


def differentiable(change, at, *, within=1e-4, step=1e-7):
    """Whether the gradient of a scalar function of one number is its difference quotient."""
    x = torch.tensor(at, dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(change(x), x)
    with torch.no_grad():
        after, before = change(x + step), change(x - step)
    rounding = 1e-15 * abs(float(after)) / step
    assert math.isfinite(float(slope))
    quotient = float(after - before) / (2.0 * step)
    assert float(slope) == pytest.approx(quotient, rel=within, abs=rounding + 1e-9)


def lobe(*, roughness=None, specular=None, light=0.7, view=0.5, around=2.0):
    full = torch.ones(1, 1, 1, dtype=torch.float64)

    def spread(value, default):
        return full * (default if value is None else value)

    def place(cosine, angle):
        cosine = torch.as_tensor(cosine, dtype=torch.float64)
        sine = (1.0 - cosine * cosine).clamp_min(0.0).sqrt()
        vector = torch.stack([sine * math.cos(angle), sine * math.sin(angle), cosine])
        return vector[:, None, None]

    return cook_torrance(
        0.3 * full.expand(3, 1, 1), spread(specular, 0.04), spread(roughness, 0.4),
        column(UP), place(light, 0.0), place(view, around),
    )[0].sum()  # fmt: skip


@pytest.mark.parametrize("at", [0.5 * MIN_ROUGHNESS, 2.0 * MIN_ROUGHNESS, 0.01, 0.5, 0.999])
def test_gradient_by_roughness_on_both_sides_of_its_clamp(at):
    differentiable(lambda r: lobe(roughness=r, around=math.pi, view=0.7), at, step=1e-7 * at)


@pytest.mark.parametrize("at", [0.0, 1e-6, 0.5, 1.0])
def test_gradient_by_f0_at_its_ends(at):
    differentiable(lambda f: lobe(specular=f), at)


@pytest.mark.parametrize("at", [-0.3, -1e-4, 1e-4, 1e-2, 0.9])
def test_gradient_by_the_light_on_both_sides_of_the_horizon(at):
    differentiable(lambda c: lobe(light=c), at, step=1e-8)
    differentiable(lambda c: lobe(view=c), at, step=1e-8)


@pytest.mark.parametrize("ratio", [0.25, 4.0])
def test_gradient_on_both_sides_of_the_smallest_denominator(ratio):
    """Both cosines grazing: n.l sqrt(...) + n.v sqrt(...) about 1e-7 times the ratio."""
    at = 1e-7 * ratio / (2.0 * 0.4**2)
    differentiable(lambda c: lobe(light=c, view=at, around=2.0), at, step=0.03 * at, within=1e-2)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("length", [0.0, 1e-30, 1e-12, 1.0, 1e12])
def test_vectors_of_any_length_are_normalised_with_finite_gradients(dtype, length):
    vector = (length * column([0.6, 0.0, -0.8])).to(dtype).requires_grad_()
    unit = normalize(vector)
    unit.sum().backward()
    assert torch.isfinite(vector.grad).all()
    size = float(unit.detach().norm())
    # Squares below the smallest float count as 0: such a vector has no direction.
    assert size == pytest.approx(1.0, abs=1e-5) or (size == 0 and length <= 1e-20)


@pytest.mark.parametrize("slope", [0.0, 1.0, 1e3, 1e8, 1e18])
def test_normals_of_any_slope_have_unit_length(slope):
    dh_dx = torch.full((1, 1, 1), slope, requires_grad=True)
    normal = normals_from_slopes(dh_dx, torch.zeros(1, 1, 1))
    normal.sum().backward()
    assert float(normal.detach().norm()) == pytest.approx(1.0, abs=1e-6)
    assert torch.isfinite(dh_dx.grad).all()


def test_where_the_papers_code_gave_nan():
    """Both albedos 0; one channel and the roughness 0; the light very far: all in one rendering."""
    stacked = torch.full((6, 4, 4), 0.5)
    stacked[:4, 0, 0] = 0.0
    stacked[[0, 4], 0, 1] = 0.0
    stacked[:5, 1, 1] = 0.0
    stacked[5] = torch.linspace(0.0, 0.01, 16).view(4, 4)
    stacked.requires_grad_()
    for distance in (1e-3, 1.0, 1e6, 1e15):
        maps = MapSet.from_stacked(stacked, 0.01)
        points = torch.zeros(3, 4, 4)
        radiance = shade(
            maps, points, torch.tensor([0.0, 0.0, 2.0]),
            torch.tensor([0.0, 0.3 * distance, distance]), torch.full((3,), distance**2),
        )  # fmt: skip
        (gradient,) = torch.autograd.grad(radiance.sum(), stacked)
        assert torch.isfinite(radiance).all()
        assert torch.isfinite(gradient).all()
        assert radiance.max() > 0
