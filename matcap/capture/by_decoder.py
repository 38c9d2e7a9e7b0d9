"""Capture by the paper's generator: a pretrained decoder, fine-tuned to windows of the
photographs.
"""

from __future__ import annotations

import math
from dataclasses import replace

from matcap.capture.exemplar.estimate import ExemplarEstimate, KnownMeans, estimate_exemplar
from matcap.capture.exemplar.network.network import load_inverse
from matcap.capture.rectified import FEATURES, WINDOW, Method, Rectified
from matcap.capture.result import CaptureResult, Tuning, judge_material, provenance
from matcap.capture.settings import CaptureClock, CaptureSettings, Effort, RunStatus
from matcap.field.material import Material
from matcap.files.process import postponed
from matcap.space.decoder import DecoderConfig, with_drawing
from matcap.space.freeze import Drawing
from matcap.space.tuned import TunedDecoder
from matcap.space.tuning.finetune import (
    RATE_WITH_DRAWING,
    InitialDecoder,
    Tuned,
    TuneSettings,
    finetune,
    initial_decoder,
)
from matcap.space.tuning.match import (
    PhotographTarget,
    cut_windows,
    match_photograph,
    self_difference,
)
from matcap.statistics.compare import FilterBank

# Texture statistics of windows of photographs, the target of optimisation.

_WINDOW_STEP = 16  # texels: sides of windows are multiples of this, the decoder's alignment


def photograph_target(
    rectified: Rectified, method: Method, most: int | None = None
) -> PhotographTarget:
    """Windows and statistics for the texture distance.

    Args:
        rectified: the photograph, at the network's resolution.
        method: has the weights.
        most: largest number of windows, or None.
    """
    plane, coarse = rectified.whole, rectified.coarse
    side = min(WINDOW, *(side // _WINDOW_STEP * _WINDOW_STEP for side in plane.size))
    bank = FilterBank(FEATURES)
    return PhotographTarget(
        cut_windows(plane, bank, side, most=most),
        coarse.setup,
        plane.encoding,
        bank,
        rectified.waves,
        plane.texel_size,
        weights=method.weights,
        expected=coarse.logits(),
    )


# Capture by the paper's generator: a pretrained decoder, fine-tuned to the photograph
# [henzler2021, sec. 4.6].
#
# Beyond the paper the decoder reads a drawing (space/freeze.py) of the exemplar, which is
# estimated first, as by default. Stages: those of estimate_exemplar, statistics, start,
# fine-tuning, matching, verdict.


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
        return estimate_exemplar(rectified, load_inverse(), clock, KnownMeans(absolute=True))

    estimate = estimated(clock) if settings.draws else None
    with clock.stage("statistics"):
        most = None if effort.steps else 1
        target = photograph_target(rectified, method, most)
        drawing = None if estimate is None else Drawing(estimate.example)
        if drawing is not None:  # it shows the lattice already, with the exemplar's phases
            target = replace(target, waves=())
        window_distance = self_difference(target.windows, target.weights)
        tune = TuneSettings(steps=effort.steps, places=effort.places, seed=settings.seed)
    start = _start(rectified, settings, target, tune, clock)
    target = replace(target, drawing=drawing)
    decoder, tuned = tuned_decoder(plane.texel_size, start, target, tune, clock, window_distance)
    about = provenance(rectified, settings, effort, [])
    material = decoder.material(photo.stem, coarse.setup, about)
    if tuned.history and effort.matched:
        with clock.completed("matching"):
            material = match_photograph(material, plane, settings.seed)
    if estimate is None and settings.aligned:
        with postponed() as stopped:
            estimate = estimated(CaptureClock(None))
        if stopped():
            clock.status = RunStatus.INTERRUPTED
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


def tuned_decoder(
    texel_size: float,
    start: InitialDecoder,
    target: PhotographTarget,
    tune: TuneSettings,
    clock: CaptureClock,
    window_distance: float,
) -> tuple[TunedDecoder, Tuned]:
    """Fine-tune a decoder, with a drawing among its inputs if the target has one.

    Its texels have a side of `texel_size` plane units; `window_distance` is the unit of the errors
    that the clock reports. A start that reads a drawing has its own rate.
    """
    decoder, rate = start.decoder, start.rate
    if target.drawing is not None and not decoder.config.drawing:
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
    if tuned.interrupted:
        clock.status = RunStatus.INTERRUPTED
    network = tuned.decoder.eval().requires_grad_(False)
    made = TunedDecoder(
        network, start.code, tuned.moments, target.waves, texel_size, target.drawing
    )
    return made, tuned


def _upright(material: Material) -> Material:
    """A decoder's material with its field rotated to a portrait."""
    tuned, setup = material.part(TunedDecoder), replace(material.setup, turned=True)
    assert tuned is not None
    return tuned.material(material.name, setup, material.provenance)
