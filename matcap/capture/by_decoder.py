"""Capture by the paper's generator: a pretrained decoder, fine-tuned to the photograph
[henzler2021, sec. 4.6].

Stages: statistics, start, fine-tuning, matching, verdict; with CaptureSettings.aligned also the
stages of find_piece, which estimate the exemplar's maps.
"""

from __future__ import annotations

import math
from dataclasses import replace

from matcap.capture.ending import judged, provenance
from matcap.capture.method import Method
from matcap.capture.piece.find import ExemplarEstimate, find_piece
from matcap.capture.piece.network.store import load_inverse
from matcap.capture.progress import CaptureClock
from matcap.capture.result import CaptureResult, Tuning
from matcap.capture.settings import CaptureSettings, Effort
from matcap.capture.start import CaptureStart
from matcap.capture.target import photograph_target
from matcap.errors import MatcapError
from matcap.files.interrupts import postponed
from matcap.space.decoder import DecoderConfig
from matcap.space.tuned import TunedDecoder
from matcap.space.tuning.anytime import Forecaster, self_difference
from matcap.space.tuning.finetune import OnStep, Tuned, TuneSettings, finetune
from matcap.space.tuning.initialisation import initial_decoder
from matcap.space.tuning.likeness import PhotographTarget
from matcap.space.tuning.match import match_photograph

_PORTRAIT_NOTE = (
    "The photograph is a portrait: the decoder's maps are rotated 90 degrees anticlockwise."
)


def capture_by_decoder(
    shot: CaptureStart,
    settings: CaptureSettings,
    effort: Effort,
    method: Method,
    clock: CaptureClock,
) -> CaptureResult:
    """Capture a photograph as a fine-tuned decoder.

    Args:
        shot: the photograph, its coarse fit and plane.
        settings: of the user.
        effort: steps and windows that follow from the settings.
        method: variant of the method.
        clock: of the capture.

    Raises:
        MatcapError: the prior cannot be read, or the picture is too small for `target`.
    """
    photo, coarse, plane = shot.photo, shot.coarse, shot.plane
    with clock.stage("statistics"):
        most = None if effort.steps else 1
        target, joined = photograph_target(shot, settings, method, most)
        own = self_difference(target.windows, target.weights)
        tune = _tune(settings, effort, method, own, photo.name)

    on_step = _on_step(clock, own)
    decoder, tuned = _tuned_decoder(shot, settings, method, target, tune, clock, on_step)
    about = provenance(photo, settings, coarse, effort, joined)
    material = decoder.material(photo.stem, coarse.setup, about)
    if tuned.history and effort.matched:
        # Of several photographs, the first is matched.
        with clock.stage("matching"), postponed() as stopped:
            material = match_photograph(material, plane, settings.seed)
        clock.interrupted |= stopped()

    estimate = _piece(shot, clock) if settings.aligned else None
    went = Tuning(tuned.history, own)
    if photo.turned:
        photo = replace(photo, notes=(*photo.notes, _PORTRAIT_NOTE))
    return judged(photo, material, shot.rectified, settings, clock, estimate, went)


def _tuned_decoder(
    shot: CaptureStart,
    settings: CaptureSettings,
    method: Method,
    target: PhotographTarget,
    tune: TuneSettings,
    clock: CaptureClock,
    on_step: OnStep,
) -> tuple[TunedDecoder, Tuned]:
    """Initialise a decoder from the prior and fine-tune it."""
    with clock.stage("start"):
        start = initial_decoder(
            shot.photo.developed(shot.photo.pixels),  # as the encoder was trained on
            shot.coarse,
            shot.plane,
            target,
            tune,
            settings.prior,
            method.decoder or DecoderConfig(),
            search=settings.time_limit is None,
        )
    with clock.stage("fine-tuning"):
        limit = clock.left_for("fine-tuning")
        seconds = limit if math.isfinite(limit) else None
        tune = replace(tune, seconds=seconds, learning_rate=start.rate)
        tuned = finetune(start.decoder, start.code, target, tune, on_step)
    clock.interrupted |= tuned.interrupted
    network = tuned.decoder.eval().requires_grad_(False)
    decoder = TunedDecoder(network, start.code, tuned.moments, shot.waves, shot.plane.texel_size)
    return decoder, tuned


def _tune(
    settings: CaptureSettings, effort: Effort, method: Method, own: float, name: str
) -> TuneSettings:
    """Settings of fine-tuning, except learning rate and time limit."""
    return TuneSettings(
        steps=effort.steps,
        target=_target(settings, own, name),
        places=effort.places,
        half_precision=method.half_precision,
        seed=settings.seed,
    )


def _on_step(clock: CaptureClock, own: float) -> OnStep:
    """Progress callback of fine-tuning, with a forecast."""
    ahead = Forecaster(own)
    return lambda share, error, seconds: clock.tuning(share, *ahead.after(error, seconds))


def _piece(shot: CaptureStart, clock: CaptureClock) -> ExemplarEstimate:
    """Estimate the exemplar, to the end even if interrupted."""
    with postponed() as stopped:
        estimate = find_piece(shot.rectified, shot.coarse, load_inverse(), CaptureClock(None))
    clock.interrupted |= stopped()
    return estimate


def _target(settings: CaptureSettings, own: float, name: str) -> float | None:
    """Loss at which fine-tuning ends: settings.target times `own`; None without a target.

    `own` is the texture distance between neighbouring windows of the photograph, NaN if it is too
    small for two. Raises MatcapError then.
    """
    if settings.target is not None and math.isnan(own):
        raise MatcapError(
            "the picture is too small to be compared with itself",
            where=name,
            remedy="raise --detail, or give --steps or --time in place of --target",
        )
    return None if settings.target is None else settings.target * own
