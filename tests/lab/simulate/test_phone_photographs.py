"""Photographs as hands take them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from matcap.lab.simulate.phone_photographs import PhonePhotographs
from matcap.lab.simulate.photograph import PhoneCamera
from matcap.lab.simulate.specimen import EXAMPLES
from matcap.photo.load import load_photo

SMALL = PhoneCamera(96, 72, supersampling=1)


def test_a_material_is_photographed_in_the_same_way_at_every_time_and_others_otherwise():
    rust, tile = (PhonePhotographs.of(EXAMPLES[name], SMALL) for name in ("rust", "tile"))
    again = PhonePhotographs.of(EXAMPLES["rust"], SMALL)
    assert (rust.phone, rust.hand, rust.tilt) == (again.phone, again.hand, again.tilt)
    assert rust.phone != tile.phone and rust.tilt != tile.tilt


def named(name, material=EXAMPLES["plaster"].material):
    return replace(EXAMPLES["plaster"], name=name, material=material)


def test_exposures_are_those_of_real_photographs():
    phones = [PhonePhotographs.of(named(f"plaster {number}"), SMALL).phone for number in range(400)]
    brightness = np.quantile([phone.brightness for phone in phones], (0.05, 0.5, 0.95))
    assert brightness == pytest.approx([0.075, 0.133, 0.236], rel=0.15)
    clipped = [phone.clipped for phone in phones]
    assert np.median(clipped) == pytest.approx(0.0, abs=1e-4) and max(clipped) <= 0.02


def test_from_further_away_slopes_stay_and_more_is_seen():
    pieces, asked = named("").pieces, []

    def spy(width, height, seed, texel_size):
        asked.append(texel_size)
        return pieces(seed)(width, height, texel_size)

    maps = PhonePhotographs.of(named("far", spy), SMALL).specimen.pieces(3)(32, 32, 0.01)
    (texel,) = asked
    assert 0.5**0.5 <= texel / 0.01 <= 2.0**0.5 and texel != 0.01
    assert maps.texel_size == 0.01
    assert torch.allclose(maps.normal, pieces(3)(32, 32, texel).normal, atol=1e-6)


def test_photographs_are_taken_once_and_their_truth_is_kept(tmp_path):
    held = PhonePhotographs.of(EXAMPLES["plaster"], SMALL)
    paths, setup = held.take(2, tmp_path)
    assert [path.name for path in paths] == ["plaster_0.dng", "plaster_1.dng"]
    written = paths[0].stat().st_mtime_ns
    again, same = held.take(2, tmp_path)
    assert again == paths and same == setup and paths[0].stat().st_mtime_ns == written
    more, _ = held.take(3, tmp_path)
    assert len(more) == 3 and all(path.exists() for path in more)
    mean = float(load_photo(paths[0], noise=False).pixels.mean())
    assert mean <= held.phone.brightness * 1.1
    assert setup.tilt == held.tilt and setup.intensity[0] > 0.0
