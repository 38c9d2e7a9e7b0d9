"""The alignment branch: what it says of photographs, how sure it is, and its file."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from simulated.materials import piece
from simulated.photographs import PhoneCamera, as_photo, take

from matcap.errors import MatcapError
from matcap.flash.geometry import FlashSetup
from matcap.space.alignment import (
    SHIPPED,
    Alignment,
    load_alignment,
    save_alignment,
    tilt_measurement,
)


def tilted_photo(seed, tilt=(0.0, 0.0), width=320):
    """Leather or granite, as RAW, its camera tilted by radians."""
    phone = PhoneCamera(width=width, height=width * 3 // 4, supersampling=1)
    setup = FlashSetup(offset=(0.03, 0.12, 0.0), tilt=tilt)
    return as_photo(take(piece(("leather", "granite")[seed % 2], seed), phone, setup), 1, "tilted")


@pytest.mark.parametrize("axis", [0, 1])
def test_it_leans_the_right_way_and_is_not_always_as_sure(axis):
    """A sign turned in either angle would make errors twice as large as saying nothing."""
    errors, deviations = [], []
    for seed, angle in enumerate((-0.2, -0.15, 0.15, 0.2)):
        found = tilt_measurement(tilted_photo(seed, (angle, 0.0) if axis == 0 else (0.0, angle)))
        errors.append(abs(found[axis] - angle))
        deviations.append(found[axis + 2])
    assert np.mean(errors) < 0.175 and min(deviations) > 0.0
    assert max(deviations) > min(deviations)


def test_brightness_does_not_matter_and_what_is_left_out_is_not_seen():
    photo = tilted_photo(3)
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
