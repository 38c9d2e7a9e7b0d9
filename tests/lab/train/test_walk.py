"""What is measured of walks and realisations: known answers."""

import torch

from matcap.lab.train.walk import apart, good_steps, walk


def test_good_steps_lead_away_and_towards():
    assert good_steps(([0.0, 1.0, 2.0], [2.0, 1.0, 0.0])) == 2
    assert good_steps(([0.0, 1.0, 0.5], [2.0, 1.0, 0.0])) == 1
    assert good_steps(([0.0, 1.0, 2.0], [2.0, 2.5, 0.0])) == 1


def test_a_walk_begins_and_ends_at_its_ends(prior):
    away, towards = walk(prior.draw(1), prior.draw(2), steps=2)
    assert away[0] == towards[-1] == 0.0
    assert away[-1] == towards[0] > 0.0


def test_copies_are_not_apart_and_seeds_are():
    one, two = torch.rand(2, 1, 3, 64, 64, generator=torch.Generator().manual_seed(1))
    assert apart([one, one]) == 0.0
    assert apart([one, two]) > 10 * apart([one, one + 0.001 * two])
