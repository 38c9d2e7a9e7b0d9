"""Heights are the exemplar's where nothing was rearranged, and join where something was."""

import numpy as np
from exemplars import an_example, ordered

from matcap.example.relief import FRACTION, REACH, bands_of, joined
from matcap.field.plane import Rectangle


def test_what_is_not_rearranged_keeps_its_height():
    codes = np.random.default_rng(1).integers(0, 2**16, (80, 90))
    bands = bands_of(codes)
    found = joined(bands)
    expected = codes[REACH:-REACH, REACH:-REACH] << FRACTION
    # Within the roundings of the filters, far below a unit of height.
    assert np.abs(found - expected)[REACH:-REACH, REACH:-REACH].max() < 1 << (FRACTION - 2)


def test_a_step_becomes_a_slope():
    plane = np.full((1, 120), 1000)
    codes = np.repeat(plane, 100, axis=0)
    low, high = bands_of(codes), bands_of(codes + 640)
    both = np.concatenate([low[:, :, :60], high[:, :, 60:]], axis=2)
    steps = np.diff(joined(both), axis=1) / (1 << FRACTION)
    assert steps.sum(axis=1).round().tolist() == [640.0] * steps.shape[0]
    assert steps.max() < 640 / 8


def test_seams_cast_no_steeper_steps_than_the_exemplar_has():
    for example in (an_example(), ordered()):
        height = example.maps(2, Rectangle(0, 0, 300, 300), None)[5]
        own = example.exemplar.height[0]
        for axis in (0, 1):
            steps, usual = (np.abs(np.diff(one, axis=axis)) for one in (height, own))
            assert np.quantile(steps, 0.999) < 1.15 * np.quantile(usual, 0.999)
