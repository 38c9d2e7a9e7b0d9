"""Anchors in the space, and what lies near them."""

from dataclasses import replace

import pytest
import torch
from small import coarse, small_photo

from matcap.errors import UsageError
from matcap.space.decoder import CODE_SIZE
from matcap.space.prior.anchors import Anchor, Anchors
from matcap.space.prior.base import VARYING, base_of, varying
from matcap.space.prior.store import load_prior
from matcap.space.tuned import TunedDecoder
from matcap.statistics.lattice import Wave

WOVEN = (Wave(0.0625, 0.0), Wave(0.0, 0.125))


def anchor(seed, waves=()):
    generator = torch.Generator().manual_seed(seed)
    numbers = torch.randn(CODE_SIZE + VARYING, generator=generator)
    return Anchor(numbers[:CODE_SIZE], numbers[CODE_SIZE:], waves)


@pytest.fixture
def known(prior):
    """A prior that knows two anchors."""
    one, other = anchor(1, WOVEN), anchor(2)
    codes, rest = (torch.stack([getattr(a, key) for a in (one, other)]) for key in ("code", "rest"))
    waves = torch.tensor([WOVEN, ((0.0, 0.0), (0.0, 0.0))])
    return replace(prior, anchors=Anchors(codes, rest, waves))


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def test_without_spread_a_anchor_is_drawn_itself():
    here = anchor(1, WOVEN)
    drawn = here.near(0.0, generator())
    assert torch.equal(drawn.code, here.code) and torch.equal(drawn.rest, here.rest)
    assert drawn.waves == WOVEN


def test_with_all_spread_nothing_of_a_anchor_is_left_but_its_order():
    one, other = anchor(1).near(1.0, generator()), anchor(2).near(1.0, generator())
    assert torch.equal(one.code, other.code)


def test_more_spread_is_farther_and_keeps_the_variance():
    here = anchor(1)
    steps = [here.near(spread, generator()) for spread in (0.1, 0.3, 0.6)]
    apart = [float((step.code - here.code).norm()) for step in steps]
    assert apart == sorted(apart)
    many = torch.stack([anchor(i).near(0.6, generator(i + 999)).code for i in range(400)])
    assert float(many.var(0).mean()) == pytest.approx(1.0, abs=0.05)


def test_a_base_is_told_by_code_and_rest(prior):
    habits, code = prior.conditional_mean, anchor(3).code
    base = base_of(coarse(), torch.tensor([0.2, 0.3, 0.25]))
    again = habits.base(code, habits.rest(code, base))
    torch.testing.assert_close(varying(again), varying(base), atol=1e-4, rtol=1e-4)


def test_draws_are_near_the_anchors_and_bring_their_order(known):
    waves = {known.draw(seed).part(TunedDecoder).waves for seed in range(12)}
    assert waves == {WOVEN, ()}
    codes = torch.stack(
        [known.draw(seed, spread=0.05).part(TunedDecoder).code for seed in range(12)]
    )
    assert float(torch.cdist(codes, known.anchors.codes).min(dim=1).values.max()) < 0.15 * 8.0


def test_a_draw_may_be_near_a_place_of_ones_own(known):
    here = anchor(7, WOVEN)
    at, near, far = (known.draw(3, near=here, spread=t) for t in (0.0, 0.3, 1.0))
    at, near, far = (material.part(TunedDecoder) for material in (at, near, far))
    assert torch.equal(at.code, here.code)
    assert [each.waves for each in (at, near)] == [WOVEN, WOVEN]
    assert float((near.code - here.code).norm()) < float((far.code - here.code).norm())


@pytest.mark.parametrize("spread", [-0.1, 1.5, float("nan")])
def test_a_spread_that_is_none_is_refused(known, spread):
    with pytest.raises(UsageError, match="between 0 and 1"):
        known.draw(0, spread=spread)


def test_a_photograph_has_a_place(known):
    photo = small_photo(0)
    place = known.place(photo)
    assert place.code.shape == (CODE_SIZE,) and place.rest.shape == (VARYING,)
    assert bool(torch.isfinite(known.draw(0, near=place).maps(48, 32).stacked()).all())


def test_anchors_come_back_with_their_prior(known, tmp_path):
    known.save(tmp_path / "prior.safetensors")
    again = load_prior(tmp_path / "prior.safetensors")
    assert again.anchors is not None and len(again.anchors) == 2
    assert torch.equal(again.anchors.codes, known.anchors.codes)
    assert again.anchors[0].waves == WOVEN and again.anchors[1].waves == ()
