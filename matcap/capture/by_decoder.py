"""Capture by the paper's generator: a pretrained decoder, fine-tuned to the photograph
[henzler2021, sec. 4.6].

Beyond the paper the decoder reads a drawing (space/drawing.py) of the exemplar, which is estimated
first, as by default. Stages: those of estimate_exemplar, statistics, start, fine-tuning,
matching, verdict.
"""

from __future__ import annotations

import math
from dataclasses import replace

from matcap.capture.exemplar.estimate import ExemplarEstimate, estimate_exemplar
from matcap.capture.exemplar.network.network import load_inverse
from matcap.capture.method import Method
from matcap.capture.progress import CaptureClock
from matcap.capture.rectified import Rectified
from matcap.capture.result import CaptureResult, Tuning, judge_material, provenance
from matcap.capture.settings import CaptureSettings, Effort
from matcap.capture.target import photograph_target
from matcap.field.material import Material
from matcap.files.interrupts import postponed
from matcap.space.decoder import DecoderConfig, with_drawing
from matcap.space.drawing import Drawing
from matcap.space.tuned import TunedDecoder
from matcap.space.tuning.finetune import (
    RATE_WITH_DRAWING,
    Tuned,
    TuneSettings,
    finetune,
)
from matcap.space.tuning.initialisation import InitialDecoder, initial_decoder
from matcap.space.tuning.likeness import PhotographTarget
from matcap.space.tuning.match import match_photograph
from matcap.space.tuning.windows import self_difference


def capture_by_decoder(
    rectified: Rectified,
    settings: CaptureSettings,
    effort: Effort,
    method: Method,
    clock: CaptureClock,
) -> CaptureResult:
    """Capture a photograph as a fine-tuned decoder.

    Args:
        rectified: the photograph, at the network's resolution.
        settings: of the user.
        effort: steps and windows that follow from the settings.
        method: variant of the method.
        clock: of the capture.

    Raises:
        MatcapError: the prior cannot be read.
    """
    photo, coarse, plane = rectified.photo, rectified.coarse, rectified.whole

    def estimated(clock: CaptureClock) -> ExemplarEstimate:  # at the coarse fit's exposure
        return estimate_exemplar(rectified, load_inverse(), clock, absolute=True)

    estimate = estimated(clock) if settings.draws else None
    with clock.stage("statistics"):
        most = None if effort.steps else 1
        target = photograph_target(rectified, settings, method, most)
        drawing = None if estimate is None else Drawing(estimate.example)
        if drawing is not None:  # it shows the lattice already, with the exemplar's phases
            target = replace(target, waves=())
        window_distance = self_difference(target.windows, target.weights)
        tune = TuneSettings(
            steps=effort.steps,
            places=effort.places,
            seed=settings.seed,
        )
    start = _start(rectified, settings, target, tune, clock)
    target = replace(target, drawing=drawing)
    decoder, tuned = _tuned_decoder(rectified, start, target, tune, clock, window_distance)
    about = provenance(rectified, settings, effort, [])
    material = decoder.material(photo.stem, coarse.setup, about)
    if tuned.history and effort.matched:
        with clock.stage("matching"), postponed() as stopped:
            material = match_photograph(material, plane, settings.seed)
        clock.interrupted |= stopped()

    if estimate is None and settings.aligned:
        with postponed() as stopped:
            estimate = estimated(CaptureClock(None))
        clock.interrupted |= stopped()
    went = Tuning(tuned.history, window_distance, drawing is not None)
    if photo.turned:  # all above is in landscape format
        material = _upright(material)
        estimate = estimate and estimate.upright(rectified.waves)
    return judge_material(rectified, material, settings, clock, estimate, went)


def _start(
    rectified: Rectified,
    settings: CaptureSettings,
    target: PhotographTarget,
    tune: TuneSettings,
    clock: CaptureClock,
) -> InitialDecoder:
    """The prior's decoder, or a random one; it reads no drawing."""
    with clock.stage("start"):
        return initial_decoder(
            rectified.photo.developed(rectified.photo.pixels),  # as the encoder was trained on
            rectified.coarse,
            rectified.whole,
            target,
            tune,
            settings.prior,
            DecoderConfig(),
        )


def _tuned_decoder(
    rectified: Rectified,
    start: InitialDecoder,
    target: PhotographTarget,
    tune: TuneSettings,
    clock: CaptureClock,
    window_distance: float,
) -> tuple[TunedDecoder, Tuned]:
    """Fine-tune a decoder, with a drawing among its inputs if the target has one.

    `window_distance` is the unit of the errors that the clock reports.
    """
    decoder, rate = start.decoder, start.rate
    if target.drawing is not None:
        decoder, rate = with_drawing(decoder), RATE_WITH_DRAWING
    with clock.stage("fine-tuning"):
        limit, unit = clock.left_for("fine-tuning"), window_distance or math.nan
        seconds = limit if math.isfinite(limit) else None
        tune = replace(tune, seconds=seconds, learning_rate=rate)
        tuned = finetune(
            decoder,
            start.code,
            target,
            tune,
            lambda share, error, taken: clock.tuning(share, error / unit),
        )
    clock.interrupted |= tuned.interrupted
    network = tuned.decoder.eval().requires_grad_(False)
    made = TunedDecoder(
        network, start.code, tuned.moments, target.waves, rectified.whole.texel_size, target.drawing
    )
    return made, tuned


def _upright(material: Material) -> Material:
    """A decoder's material with its field rotated to a portrait."""
    tuned, setup = material.part(TunedDecoder), replace(material.setup, turned=True)
    assert tuned is not None
    return tuned.material(material.name, setup, material.provenance)
