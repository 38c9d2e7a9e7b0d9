"""Highlights that are kept, and flash and tilt that are found."""

import math

import pytest

from matcap.flash.coarse.fit import fit_coarse
from matcap.lab.bench import highlight
from matcap.lab.bench.highlight import highlight_experiment, kept, placed, simulated


@pytest.fixture(scope="module")
def visible():
    """A simulated photograph whose highlight is plain to see, and its fit."""
    for make in simulated(12, 0).values():
        photo, setup = make()
        if placed((photo, setup), fit_coarse(photo))["visible"]:
            return photo, setup, fit_coarse(photo)
    raise AssertionError("no highlight is plain to see in any")


def test_simulated_photographs_tell_errors_and_real_ones_highlights(visible):
    photo, setup, fit = visible
    of_simulated = placed((photo, setup), fit)
    assert 0.0 < of_simulated["offset"] < 1.0 and 0.0 < of_simulated["tilt"] < 30.0
    assert math.isnan(placed((photo, None), fit)["tilt"])
    assert math.isnan(kept((photo, setup), fit)["width"])
    of_real = kept((photo, None), fit)
    assert of_real["apart"] < 0.2 and 0.3 < of_real["width"] < 3.0


def test_a_highlight_that_is_not_rendered_is_lost(visible, monkeypatch):
    photo, _, fit = visible
    monkeypatch.setattr(highlight, "rerendered", lambda fit, photo: 0.0 * photo.pixels + 0.2)
    found = kept((photo, None), fit)
    assert (found["kept"], found["width"], found["apart"]) == (0.0, 0.0, math.inf)


def test_a_photograph_s_name_and_truth_follow_from_seed_and_number():
    assert list(simulated(3, 5)) == list(simulated(4, 5))[:3]
    few, more = ([make for make in simulated(n, 5).values()][1]() for n in (2, 3))
    assert few[1] == more[1]


def test_nothing_is_simulated_without_being_asked_for(tmp_path):
    assert highlight_experiment((), 0, 0, tmp_path).subjects == {}
