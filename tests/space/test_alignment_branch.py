"""The alignment branch: what it says of photographs, how sure it is, and its file."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from matcap.errors import MatcapError
from matcap.lab.train.align import UNSEEN, tilted_photo
from matcap.space.alignment import (
    SHIPPED,
    Alignment,
    load_alignment,
    save_alignment,
    tilt_measurement,
)


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


def test_brightness_does_not_matter_and_what_is_left_out_is_not_seen():
    photo, _ = tilted_photo(UNSEEN + 3, 320)
    whole = tilt_measurement(photo)
    darker = tilt_measurement(replace(photo, pixels=0.5 * photo.pixels))
    assert darker[:2] == pytest.approx(whole[:2], abs=0.01)
    out = np.zeros(photo.pixels.shape[:2], bool)
    out[:40, :60] = True
    painted = photo.pixels.copy()
    painted[out] = 1.0
    masked = tilt_measurement(replace(photo, left_out=out))
    assert tilt_measurement(replace(photo, left_out=out, pixels=painted)) == masked


def test_its_file_comes_back_and_says_what_is_wrong(tmp_path):
    torch.manual_seed(0)
    branch = Alignment().eval()
    save_alignment(tmp_path / "branch.safetensors", branch)
    again = load_alignment(tmp_path / "branch.safetensors")
    for name, value in branch.state_dict().items():
        assert torch.equal(again.state_dict()[name], value.half().float())
    save_file({"x": torch.zeros(2)}, tmp_path / "other.safetensors")
    for name, why in (("other", "not an alignment branch"), ("absent", "cannot be read")):
        with pytest.raises(MatcapError, match=why):
            load_alignment(tmp_path / f"{name}.safetensors")
    assert load_alignment(SHIPPED) is not None
