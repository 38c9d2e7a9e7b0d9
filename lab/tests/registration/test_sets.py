"""Cameras of sets of photographs, easy and hard; sweep.py registers three hundred of them."""

from dataclasses import replace

import numpy as np
from sets import HARD, SetOutcome, columns, compared, kinds, make_set, outcome_of, unsaid, verdict

from matcap.capture.registration.register import register
from matcap.flash.coarse.fit import fit_coarse

WIDTH = 400


def test_a_foreign_photograph_is_named_and_others_stay():
    made = make_set(11, hard="foreign", width=WIDTH)
    found = register(made.photos, fit_coarse(made.photos[0]).setup)
    assert [one.name for one in found.left_out] == ["foreign"]
    outcome = compared(made, found)
    assert outcome.taken_in == 0 and max(outcome.errors) < 0.01


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


RIGHT = SetOutcome((0.001, 0.002), ("p3: blurred",), 0, 0.1)
NEAR = SetOutcome((0.001, 0.01), (), 0, 0.1)
REFUSED = SetOutcome((), ("p1: too little of it is found",), 0, 0.1)
FAR = SetOutcome((0.03,), (), 0, 0.1)
TAKEN_IN = SetOutcome((0.001,), (), 1, 0.1)


def test_a_set_is_as_right_as_its_worst_camera():
    every = (RIGHT, NEAR, REFUSED, FAR, TAKEN_IN)
    assert [verdict(one) for one in every] == ["right", "near", "refused", "wrong", "wrong"]
    rows = [columns(None, one) for one in every]
    assert [sum(row[name] for row in rows) for name in ("right", "near", "wrong", "unsaid")] == [
        1, 1, 2, 2,
    ]  # fmt: skip
    assert rows[0]["worst"] == 0.002 and rows[2]["why"] == "p1: too little of it is found"


def test_what_is_said_of_a_set_is_no_error_unsaid():
    said = replace(NEAR, deviations=(0.001, 0.004))
    assert [unsaid(one) for one in (RIGHT, NEAR, said, REFUSED)] == [False, True, False, False]
