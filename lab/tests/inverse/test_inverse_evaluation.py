"""What a network is judged by: the truth is without fault, and what is wrong is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from matcap.capture.exemplar.network.network import ERRORS, Inverse, InverseConfig
from matcap_lab.inverse.evaluate import (
    calibration,
    evaluate,
    photograph_as_albedo,
    relit_error,
    score,
    table,
)
from matcap_lab.inverse.samples import Sample, draw_sample


@pytest.fixture(scope="module")
def sample() -> Sample:
    return draw_sample(10, 96, 64)


def test_the_truth_scores_as_the_truth(sample: Sample) -> None:
    truth = sample.residuals.stacked()
    sure = torch.where(sample.metal > 0.5, 20.0, -20.0)
    answer = torch.cat([truth, torch.zeros(ERRORS, *truth.shape[-2:]), sure])
    result = score(answer, sample, np.random.default_rng(0))
    assert result["correlation"] == pytest.approx(1.0, abs=1e-3)
    off = [result[name] for name in ("tilt_off", "contrast_off", "relit")]
    assert off == pytest.approx([0.0, 0.0, 0.0], abs=2e-3)
    answer[5] *= 0.5  # height
    flatter = score(answer, sample, np.random.default_rng(0))
    assert flatter["tilt"] < -0.3
    assert flatter["relit"] > result["relit"]


def test_the_photograph_taken_for_albedo_is_no_good_guess(sample: Sample) -> None:
    albedo = photograph_as_albedo(sample)
    assert float(albedo.height.abs().max()) == 0.0
    assert relit_error(albedo, sample.truth, sample) > 0.03
    paler = replace(sample.truth, diffuse=sample.truth.diffuse.clamp(max=0.9))
    assert relit_error(paler, sample.truth, sample) < 0.03


def test_doubt_that_is_right_is_calibrated() -> None:
    generator = torch.Generator().manual_seed(0)
    expected = torch.rand(2, 40_000, generator=generator) + 0.1
    made = expected * torch.randn(2, 40_000, generator=generator).abs() / 0.6745
    assert torch.allclose(calibration(expected, made), torch.ones(2, 10), atol=0.08)
    assert float(calibration(expected, 3.0 * made).min()) > 2.4


def test_a_network_is_judged(sample: Sample) -> None:
    torch.manual_seed(0)
    network = Inverse(InverseConfig(widths=(8, 8, 8, 8, 8), context=8)).eval()
    judged = evaluate(network, [sample])
    assert sum(name.startswith("doubt of") for name in judged) == ERRORS
    assert all(np.isfinite(value) for value in judged.values())
    assert "| correlation |" in table({"a network": judged})
