"""Errors of coarse fits, alone and under one camera's profile."""

import math
from dataclasses import replace

import pytest
import torch
from uniform import a_setup, photograph

from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError
from matcap.flash.coarse.fit import CoarseFit
from matcap.lab.bench import cameras
from matcap.lab.bench.cameras import CameraSubject, camera_experiment, fit_errors
from matcap.lab.simulate.specimen import subjects


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


def test_too_few_photographs_are_refused(subject, monkeypatch):
    experiment = camera_experiment((), subjects(["plaster"]), (0.4, 0.5))
    fit = CoarseFit((0.1,) * 3, 0.04, 0.5, a_setup(), residual=0.0)
    monkeypatch.setattr(cameras, "fitted", lambda photo: fit)
    with pytest.raises(MatcapError, match="give five or more"):
        experiment.configurations["one camera"].run(subject, 0)
