"""Cameras of sets of photographs, easy and hard; sweep.py does three hundred of them."""

import numpy as np
from sets import HARD, compared, kinds, make_set, outcome_of, table

from matcap.flash.coarse import fit_coarse
from matcap.flash.registration.register import register

WIDTH = 400


def test_a_foreign_photograph_is_named_and_others_stay():
    made = make_set(11, hard="foreign", width=WIDTH)
    found = register(made.photos, fit_coarse(made.photos[0]).setup)
    assert [one.name for one in found.left_out] == ["foreign"]
    outcome = compared(made, found)
    assert outcome.taken_in == 0 and max(outcome.errors) < 0.01
    assert "| foreign | 1 |" in table([outcome])


def test_nothing_is_found_on_plain_plastic():
    found = outcome_of(make_set(5, hard="plain", width=WIDTH))
    assert not found.errors and found.kept_out


def test_a_third_of_all_sets_is_hard_in_every_way():
    every = kinds(300)
    assert sum(kind is not None for kind in every) == 100
    assert set(every) == {None, *HARD}


def test_exposure_balance_and_orientation_do_not_matter():
    found = outcome_of(make_set(14, hard="exposed", width=WIDTH))
    assert found.errors and np.max(found.errors) < 0.01
