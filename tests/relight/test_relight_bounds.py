"""Every effect's bound against its own effect, in scenes at the corners of its derivation."""

import pytest
from bound_scenes import share, tries

from matcap.relight import planning
from matcap.relight.effects.bound import Bound
from matcap.relight.effects.entries import Effect
from matcap.relight.planning import EFFECTS, EffectChoice, make_plan

# What the scenes reach today, less a little: a bound that grows loose is found out, too. That of
# area lights is loose: its lobes are taken to change as fast as the sharpest could.
REACHED = {
    "diffuse": 0.99, "specular": 0.4, "falloff": 0.9, "area": 0.015, "environment": 0.7,
    "filtering": 0.3, "parallax": 0.5, "shadows": 0.7, "visibility": 0.5,
    "interreflection": 0.35, "multiscatter": 0.95,
}  # fmt: skip


def test_every_effect_is_tried(tmp_path):
    assert list(tries(tmp_path)) == list(EFFECTS) == list(REACHED)


@pytest.mark.parametrize("effect", EFFECTS)
def test_no_bound_is_wrong_and_none_is_loose(effect, tmp_path):
    shares = [share(effect, one) for one in tries(tmp_path)[effect]]
    assert max(shares) <= 1.0 + 1e-5, shares
    assert max(shares) >= REACHED[effect], shares


@pytest.mark.parametrize("tolerance", [0.0, 0.3, 0.5, 0.9, 1.0, 3.2, 9.9])
def test_what_is_left_out_adds_up_to_no_more_than_the_tolerance(tolerance, monkeypatch):
    """Each of these could be left out alone at most tolerances; all of them not."""
    bounds = {name: 0.25 + 0.05 * index for index, name in enumerate(EFFECTS)}
    made = {name: Effect(lambda _, b=bound: Bound(b, "")) for name, bound in bounds.items()}
    monkeypatch.setattr(planning, "EFFECTS", made)
    steps = make_plan(None, tolerance, EffectChoice()).steps
    off = sum(step.bound for step in steps if not step.on)
    assert off <= tolerance + 1e-12
    # And nothing runs that could have been left out besides.
    assert all(off + step.bound > tolerance for step in steps if step.on)
