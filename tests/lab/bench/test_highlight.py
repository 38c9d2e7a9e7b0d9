"""The benches of highlights, gloss, metals and cameras: what is found, where it is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from uniform import a_setup, photograph

from matcap.brdf.maps import MapSet
from matcap.brdf.metals import METAL_F0
from matcap.flash.coarse.fit import CoarseFit, fit_coarse
from matcap.lab.bench import highlight
from matcap.lab.bench.cameras import CameraSubject, fit_errors
from matcap.lab.bench.gloss import PlainMaterial, gloss_experiment
from matcap.lab.bench.highlight import highlight_experiment, kept, placed, simulated
from matcap.lab.bench.metals import f0_errors
from matcap.lab.experiment.runner import run
from matcap.lab.simulate.photograph import PhoneCamera


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


SATIN = PlainMaterial((0.3, 0.2, 0.15), 0.04, 0.2, 0.0)


@pytest.mark.parametrize("size", [(256, 192), (512, 384)])
def test_bumps_are_as_steep_as_asked_for_at_any_detail(size):
    maps = PlainMaterial((0.3, 0.2, 0.15), 0.04, 0.2, 0.1).realise(*size, 2.0 / size[0])
    down, across = np.gradient(maps.height[0].numpy() / maps.texel_size)
    assert np.sqrt((down**2 + across**2).mean()) == pytest.approx(0.1, rel=1e-3)


def test_polish_is_found_though_two_stops_of_its_highlight_are_clipped(tmp_path):
    camera = PhoneCamera(800, 600, supersampling=1)
    experiment = gloss_experiment(iter([SATIN]), (0, 2), camera=camera)
    whole, clipped = run(experiment, tmp_path / "gloss.csv")
    assert clipped.number("clipped") > 2.0 * whole.number("clipped")
    assert (whole.configuration, whole.subject) == ("+0 EV", "0, 0.3, 0.04, 0.2")
    for row in (whole, clipped):
        assert row.number("roughness") == pytest.approx(0.2, abs=0.05)
        assert row.number("near") == 1.0


GOLD = torch.tensor(METAL_F0["gold"])[:, None, None]


def maps(specular: torch.Tensor) -> MapSet:
    one = torch.ones(1, 8, 16)
    return MapSet(0.1 * one.expand(3, -1, -1), specular, 0.4 * one, 0.0 * one, 0.1)


def half(metal, rest) -> torch.Tensor:
    """(C, 8, 16): metal on the left, the rest on the right."""
    left = torch.as_tensor(metal).expand(-1, 8, 8)
    return torch.cat([left, torch.full_like(left, rest)], -1)


def test_brightness_hue_and_what_lies_beside_are_told_apart() -> None:
    truth = maps(half(GOLD, 0.04))
    blue = GOLD * torch.tensor([0.5, 0.5, 0.6])[:, None, None]
    values = f0_errors(maps(half(blue, 0.06)), truth)
    colours = ("red", "green", "blue")
    assert [values[name] for name in colours] == pytest.approx([0.5, 0.5, 0.6])
    mean = float(blue.sum() / GOLD.sum())
    hue = [100.0 * (one / mean - 1.0) for one in (0.5, 0.5, 0.6)]
    assert [values[f"{name} hue"] for name in colours] == pytest.approx(hue)
    assert (values["dielectric"], values["true dielectric"]) == pytest.approx((0.06, 0.04))


def test_truth_on_a_finer_grid_and_a_grey_answer() -> None:
    truth = maps(GOLD.expand(-1, 8, 16))
    fine = truth.map(lambda m: m.repeat_interleave(2, -1).repeat_interleave(2, -2))
    values = f0_errors(maps(0.7 * torch.ones(1, 8, 16)), fine)
    assert math.isnan(values["dielectric"]) and math.isnan(values["red hue"])
    assert values["red"] == pytest.approx(0.7 / METAL_F0["gold"][0])


@pytest.fixture
def subject():
    setup = replace(a_setup(), vignetting=0.4, vignetting_quartic=0.5)
    one = torch.ones(1, 8, 8)
    maps = MapSet(0.2 * one.expand(3, 8, 8), 0.04 * one, 0.5 * one, 0.0 * one, 0.25)
    return CameraSubject(photograph(setup), maps, 0.9)


def test_errors_are_of_what_was_simulated_and_only_of_that(subject):
    true = subject.truth
    setup = replace(a_setup(), vignetting=0.4, vignetting_quartic=0.6)
    mean = float(true.diffuse.mean())
    fit = CoarseFit((mean,) * 3, 2.0 * float(true.specular.mean()), 0.5, setup, residual=0.0)
    found = fit_errors(subject, fit)
    assert found["lost off"] == pytest.approx(0.1)
    assert found["F0 over albedo off"] == pytest.approx(math.log(2.0))
    assert found["albedo off"] == pytest.approx(0.0, abs=1e-6)
    alone = fit_errors(replace(subject, truth=None), fit)
    assert alone["lost"] == pytest.approx(1.0) and math.isnan(alone["lost off"])
