"""Materials that texels of several photographs share: gold beside paint, and one dielectric."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from seen_views import LOG_ERROR, flattened, grainy, seen

from matcap.capture.multiview.basis import fit_basis
from matcap.capture.multiview.set_report import LeaveOneOut
from matcap.capture.multiview.texels import Estimate, halves_of

SIZE = (60, 80)
GOLD = torch.tensor([0.8, 0.6, 0.27])[:, None, None]


def patched(*, metal: bool):
    """Red paint, half of it covered by wide stripes of gold; (maps, bool where gold)."""
    maps = grainy(0, SIZE)
    gold = (torch.arange(SIZE[1]) // 10 % 2 == 0).expand(1, *SIZE) & torch.tensor(metal)
    red = torch.tensor([2.0, 0.5, 0.4])[:, None, None]
    return replace(
        maps,
        diffuse=torch.where(gold, torch.tensor(0.003), red * maps.diffuse),
        specular=torch.where(gold, GOLD, torch.tensor(0.04)),
        roughness=torch.where(gold, 0.3, 0.5),
    ), gold[0]


def fitted(maps):
    """Materials of six photographs, the network having seen one grey dielectric."""
    views, light = seen([maps] * 6, 0.005)
    grey = flattened(replace(maps, diffuse=maps.diffuse.mean(0).expand(3, -1, -1)))
    grey = replace(grey, specular=torch.full((1, *SIZE), 0.04), roughness=0.5 + 0.0 * grey.height)
    return fit_basis(views, Estimate(grey, LOG_ERROR.expand(4, *SIZE)), light)


@pytest.fixture(scope="module")
def gold_and_paint():
    maps, gold = patched(metal=True)
    basis, light = fitted(maps)
    return basis, light, gold


def test_gold_beside_paint_has_its_colour_and_roughness(gold_and_paint) -> None:
    basis, _, gold = gold_and_paint
    log_f0, rough, *tint = torch.einsum("kg,khw->ghw", basis.gloss, basis.shares)
    f0 = (log_f0 + torch.stack(tint)).exp()[:, gold].mean(1)
    assert float((f0.log() - GOLD.flatten().log()).abs().max()) < 0.26  # a factor of 1.3
    assert float(torch.sigmoid(rough[gold]).mean()) == pytest.approx(0.3, abs=0.05)
    assert float(log_f0[~gold].mean().exp()) == pytest.approx(0.04, rel=0.3)


def test_shares_of_the_basis_are_those_of_the_materials(gold_and_paint) -> None:
    basis, _, gold = gold_and_paint
    right = torch.where(gold, basis.metal_share[0], 1.0 - basis.metal_share[0])
    assert float(right.mean()) > 0.95
    torch.testing.assert_close(basis.shares.sum(0), torch.ones(SIZE))


def test_one_dielectric_is_one_material() -> None:
    maps, _ = patched(metal=False)
    assert fitted(replace(maps, specular=maps.specular[:1])) is None


def test_two_photographs_or_ambient_light_give_no_basis() -> None:
    maps, _ = patched(metal=True)
    views, light = seen([maps] * 3)
    prediction = Estimate(maps, LOG_ERROR.expand(4, *SIZE))
    assert fit_basis(views[:2], prediction, light.of_some([0, 1])) is None
    assert fit_basis([*views[:2], replace(views[2], flash=False)], prediction, light) is None


def test_the_first_photograph_is_kept_where_others_predict_each_other_worse() -> None:
    nan = float("nan")
    worse = LeaveOneOut((0.3, 0.2, nan, 0.2), (0.1, 0.1, nan, 0.2))
    assert worse.kept_first == pytest.approx((0.2, 0.15))
    hardly = LeaveOneOut((0.3, 0.1, 0.1), (0.1, 0.12, 0.12))
    assert hardly.kept_first == pytest.approx((0.1, 0.12))
    assert LeaveOneOut(*(each[:2] for each in hardly[:2])).kept_first is None  # two: one prediction
    # What the first one's maps say of the first itself does not count.
    better = LeaveOneOut((0.3, 0.1, nan, 0.1), (0.01, 0.1, nan, 0.2))
    assert better.kept_first is None and LeaveOneOut((), ()).kept_first is None


def test_each_half_of_the_photographs_has_cameras_to_several_sides() -> None:
    places = [np.array(place) for place in ((0, 0), (1, 0), (0, 1), (-1, 0), (0, -1))]
    one, other = halves_of(places)
    assert set(one) & set(other) == {0} and set(one) | set(other) == set(range(5))
    for half in (one, other):
        assert {abs(places[n][0]) for n in half} == {0, 1}
        assert {abs(places[n][1]) for n in half} == {0, 1}
    assert halves_of(places[:4]) == ()
