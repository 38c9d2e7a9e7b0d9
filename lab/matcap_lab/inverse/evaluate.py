"""Errors of the inverse network on held-out materials.

Fixed photographs: of real sets held out by name, and of simulated materials held out by kind.
Scores: the loss's parts, correlation and magnitude of slopes, contrast of albedo, error of relit
pictures against that of the photograph taken for albedo, and calibration of the predicted standard
deviations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.network.network import ERRORS, ExpectedErrors, Inverse, NetworkAnswer
from matcap.capture.exemplar.predict import seen_colour, specular_tint
from matcap.flash.light import shade
from matcap_lab.experiment.results import markdown
from matcap_lab.inverse.samples import HELD_OUT, PackedSet, Sample, draw_sample
from matcap_lab.inverse.train import BLACK, DARKEST, LEAST_ERROR, loss_parts, total, wanted
from matcap_lab.measures.evaluator import spherical
from matcap_lab.simulate.named import realise
from matcap_lab.simulate.photograph import RealiseAt
from matcap_lab.simulate.varied import random_material

DOUBTS = ("albedo", "F0", "roughness", "slope")
_FIRST = 50_000_000  # numbers of samples, beyond training's
_SIZE = (320, 224)
_FLAT = 0.01  # added to tilts (radians) and contrasts before their logarithm
_SAMPLED = 4  # stride in texels at which expected errors are sampled
# Polar angle and azimuth in degrees, and distance, of the lights that pictures are relit by.
_LIGHTS = ((20.0, 40.0, 2.0), (40.0, 160.0, 2.0), (55.0, 280.0, 2.5), (68.0, 100.0, 2.5))


def real_samples(sets: Sequence[PackedSet]) -> list[Sample]:
    """Photographs of real materials, two of every set."""
    return [
        draw_sample(_FIRST + 100 * index + visit, *_SIZE, sets=(packed,), real=1.0)
        for index, packed in enumerate(sets)
        for visit in range(2)
    ]


def simulated_samples() -> list[Sample]:
    """24 photographs of simulated materials of held-out kinds."""
    stride = 1_000_000  # so that each is of a piece of its own
    return [
        draw_sample(_FIRST + stride + 10_000 * i, *_SIZE, material=_left_out) for i in range(24)
    ]


def evaluate(network: Inverse, samples: Sequence[Sample]) -> dict[str, float]:
    """Mean scores of a network on photographs, and calibration of its predicted errors.

    Calibration: median error over predicted error in each tenth by prediction; the worst tenth
    counts. 1 is calibrated.
    """
    scores, expected, errors = [], [], []
    for index, sample in enumerate(samples):
        with torch.no_grad():
            outputs = network(sample.inputs[None])[0]
        scores.append(score(outputs, sample, np.random.default_rng([index, 6])))
        doubted, made = doubts(outputs, sample)
        expected.append(doubted)
        errors.append(made)
    averages = {name: sum(one[name] for one in scores) / len(scores) for name in scores[0]}
    ratios = calibration(torch.cat(expected, 1), torch.cat(errors, 1)).log().abs().amax(1).exp()
    off = zip(DOUBTS, ratios.tolist(), strict=True)
    return averages | {f"doubt of {name}, worst tenth off by": worst for name, worst in off}


def _maps(answer: NetworkAnswer, sample: Sample) -> MapSet:
    uniform = sample.uniform.parameters().to(sample.points)
    maps = (uniform + answer.residuals).maps(sample.truth.texel_size)
    tint = specular_tint(answer.metal.sigmoid(), seen_colour(sample.linear, sample.valid[None]))
    return replace(maps, specular=(maps.specular * tint).clamp_max(1.0))


@torch.no_grad()
def score(outputs: Tensor, sample: Sample, rng: np.random.Generator) -> dict[str, float]:
    """Scores of one prediction (ANSWERS, H, W).

    loss: sum of all parts but metal's, comparable with networks without it; the loss's parts;
    correlation: of slopes with the true ones; tilt, contrast: log of the estimated over the true
    mean tilt and deviation of log albedo, and their magnitudes; roughness_off: mean difference;
    relit, photograph: mean difference of log radiance under four lights, of the prediction and of
    the photograph taken for albedo.
    """
    parts = loss_parts(outputs[None], wanted([sample], rng))
    truth = sample.truth
    maps = _maps(NetworkAnswer.from_stacked(outputs), sample)
    estimated, true = _slopes(maps.normal), _slopes(truth.normal)
    tilt = _log_ratio(_tilt(maps.normal), _tilt(truth.normal))
    contrast = _log_ratio(_contrast(maps.diffuse), _contrast(truth.diffuse))
    return {
        "loss": float(total(parts, metal=0.0)),
        **{name: float(part) for name, part in parts.items()},
        "correlation": _correlation(estimated, true),
        "tilt": tilt,
        "tilt_off": abs(tilt),
        "contrast": contrast,
        "contrast_off": abs(contrast),
        "roughness_off": float((maps.roughness - truth.roughness).abs().mean()),
        "relit": relit_error(maps, truth, sample),
        "photograph": relit_error(photograph_as_albedo(sample), truth, sample),
    }


def photograph_as_albedo(sample: Sample) -> MapSet:
    """Flat maps whose albedo is the picture, scaled to the mean albedo of the coarse fit."""
    picture = sample.linear
    gain = torch.tensor(sample.uniform.diffuse)[:, None, None] / picture.mean((1, 2), keepdim=True)
    one = torch.ones_like(picture[:1])
    return MapSet(
        (picture * gain).clamp(0.001, 0.99),
        one * sample.uniform.specular,
        one * sample.uniform.roughness,
        0.0 * one,
        sample.truth.texel_size,
    )


def relit_error(maps: MapSet, truth: MapSet, sample: Sample) -> float:
    """Mean absolute difference of log radiance, less its median, over four lights."""
    points = sample.points
    camera = torch.tensor([0.0, 0.0, sample.uniform.setup.distance])
    errors = []
    for polar, around, far in _LIGHTS:
        place = torch.tensor(spherical(far, math.radians(polar), math.radians(around)))
        intensity = torch.tensor([math.pi * far**3 / float(place[2])])
        estimated, true = (
            (shade(m, points, camera, place, intensity) + DARKEST).log() for m in (maps, truth)
        )
        off = estimated - true
        # The scale between flash and albedo, ambiguous in one photograph, cancels.
        errors.append(float((off - off.median()).abs().mean()))
    return sum(errors) / len(errors)


def doubts(outputs: Tensor, sample: Sample) -> tuple[Tensor, Tensor]:
    """(ERRORS, n) predicted errors, and actual errors."""
    answer = NetworkAnswer.from_stacked(outputs)
    maps, off = _maps(answer, sample), answer.residuals - sample.residuals
    albedo = ((maps.diffuse + BLACK).log() - (sample.truth.diffuse + BLACK).log()).abs().mean(0)
    slope = (_slopes(maps.normal) - _slopes(sample.truth.normal)).abs().mean(0)
    made = ExpectedErrors(
        albedo[None], off.specular.abs(), off.roughness.abs(), slope[None]
    ).stacked()
    thin = (..., slice(1, -1, _SAMPLED), slice(1, -1, _SAMPLED))
    expected = answer.errors.stacked().exp() - LEAST_ERROR
    return expected[thin].reshape(ERRORS, -1), made[thin].reshape(ERRORS, -1)


def calibration(expected: Tensor, made: Tensor) -> Tensor:
    """(C, 10) median of actual over predicted errors, in quantiles of the predicted ones.

    Both are (C, n).
    """
    order = expected.argsort(1)
    rows = []
    for predicted, errors in zip(expected.gather(1, order), made.gather(1, order), strict=True):
        bins = zip(predicted.tensor_split(10), errors.tensor_split(10), strict=True)
        rows.append(
            torch.stack(
                [
                    (e.median() + LEAST_ERROR) / (t.median() + LEAST_ERROR).clamp_min(LEAST_ERROR)
                    for t, e in bins
                ]
            )
        )
    return torch.stack(rows)


def table(results: Mapping[str, Mapping[str, float]]) -> str:
    """Markdown: a row for each score, a column for each network and set of photographs."""
    names = dict.fromkeys(name for scores in results.values() for name in scores)
    rows = [[name, *(f"{scores[name]:.3f}" for scores in results.values())] for name in names]
    return "\n".join(markdown(["", *results], rows))


def _left_out(rng: np.random.Generator) -> RealiseAt:
    """Draw a held-out material: half of kinds, half of patterns."""
    if rng.random() < 0.5:
        return partial(realise, str(rng.choice(HELD_OUT)))
    while not (material := random_material(rng)).is_held_out:
        pass
    return material.realise


def _slopes(normal: Tensor) -> Tensor:
    return -normal[:2] / normal[2:].clamp_min(1e-3)


def _tilt(normal: Tensor) -> float:
    return float(normal[2].clamp(-1.0, 1.0).acos().mean())


def _contrast(diffuse: Tensor) -> float:
    return float((diffuse.mean(0) + 1e-3).log().std())


def _log_ratio(estimate: float, true: float) -> float:
    return math.log((estimate + _FLAT) / (true + _FLAT))


def _correlation(estimate: Tensor, true: Tensor) -> float:
    """Correlation of two fields (2, H, W), means subtracted."""
    a = estimate - estimate.mean((1, 2), keepdim=True)
    b = true - true.mean((1, 2), keepdim=True)
    return float((a * b).sum() / (a.square().sum() * b.square().sum()).sqrt().clamp_min(1e-9))
