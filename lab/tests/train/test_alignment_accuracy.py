"""The alignment branch: what it says of photographs, how sure it is, and its file."""

import math

import numpy as np
import pytest

from matcap.space.alignment import (
    tilt_measurement,
)
from matcap_lab.train.alignment import UNSEEN, tilted_photo


@pytest.fixture(scope="module")
def measured():
    """What it says of forty photographs of held-out kinds, half of them RAW, and the truth."""
    shots = [tilted_photo(UNSEEN + 500 + n, 320, radiometric=bool(n % 2)) for n in range(40)]
    return [(tilt_measurement(photo), truth) for photo, truth in shots]


def test_it_is_nearer_than_square_and_leans_the_right_way(measured):
    """Both angles: a sign turned in either would make errors twice as large as saying nothing."""
    for axis in (0, 1):
        errors = [abs(math.degrees(found[axis] - true[axis])) for found, true in measured]
        nothing = [abs(math.degrees(true[axis])) for _, true in measured]
        assert np.mean(errors) < 0.45 * np.mean(nothing)


def test_it_knows_how_far_it_is_off(measured):
    """Errors over their predicted deviations are about normal; and it is not always as sure."""
    scores = np.array([(f[a] - t[a]) / f[a + 2] for f, t in measured for a in (0, 1)])
    assert 0.5 < np.sqrt(np.mean(scores**2)) < 2.0
    deviations = [found.std_x for found, _ in measured]
    assert max(deviations) > 1.3 * min(deviations)
