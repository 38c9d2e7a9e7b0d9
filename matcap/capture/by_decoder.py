"""The paper's generator: a pretrained decoder, fine-tuned to windows of the photograph, alone or
beside the exemplar, and the choice of the generator that makes the material's maps.
"""

from __future__ import annotations

import math
from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.estimate import ExemplarEstimate, KnownMeans, estimate_exemplar
from matcap.capture.exemplar.network.network import load_inverse
from matcap.capture.rectified import FEATURES, WINDOW, Method, Rectified
from matcap.capture.result import CaptureResult, GeneratorChoice, Tuning, judge_material, provenance
from matcap.capture.settings import CaptureClock, CaptureSettings, Effort, RunStatus, resolve
from matcap.example.example import Example
from matcap.field.material import Material
from matcap.field.source import Generator
from matcap.files.process import postponed
from matcap.flash.rectify import Plane
from matcap.space.decoder import DecoderConfig, with_drawing
from matcap.space.freeze import Drawing
from matcap.space.prior.store import base_of, fold, load_drawing_start
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
    compare_windows,
    cut_windows,
    log_contrast,
    match_photograph,
    render_windows,
    self_difference,
)
from matcap.statistics.compare import FilterBank, FilterBankConfig

# Texture statistics of windows of photographs, the target of optimisation.

_WINDOW_STEP = 16  # texels: sides of windows are multiples of this, the decoder's alignment


def photograph_target(
    rectified: Rectified, method: Method, most: int | None = None
) -> PhotographTarget:
    """Windows and statistics for the texture distance.

    Args:
        rectified: the photograph, at the network's resolution.
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
    rectified: Rectified, settings: CaptureSettings, method: Method, clock: CaptureClock
) -> CaptureResult:
    """Capture a photograph as a fine-tuned decoder.

    Args:
        rectified: the photograph, at the network's resolution.

    Raises:
        MatcapError: the prior cannot be read.
    """
    photo, coarse, plane = rectified.photo, rectified.coarse, rectified.whole
    effort = resolve(settings)

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
    with clock.stage("start"):  # the prior's decoder, or a random one; it reads no drawing
        pixels, prior = photo.developed(photo.pixels), settings.prior  # as the encoder learnt
        start = initial_decoder(pixels, coarse, plane, target, tune, prior, DecoderConfig())
    target = replace(target, drawing=drawing)
    decoder, tuned = tuned_decoder(plane.texel_size, start, target, tune, clock, window_distance)
    about = provenance(rectified, settings, effort, [])
    material = decoder.material(photo.stem, coarse.setup, about)
    if tuned.history and effort.matched:
        with clock.completed("matching"):
            material, _ = match_photograph(material, plane, settings.seed)
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


# The decoder of a capture by example, fine-tuned in few steps once the exemplar is there.
#
# It draws from the material's own exemplar (space/freeze.py), at the network's resolution, so that
# both generators show the same arrangement for a seed. It starts from the prior's decoder, which
# was trained on to read drawings (space/prior/weights/prior.md).

# Highest learning rate, factor on it of weights that read the drawing, steps of warm-up; the
# start reads it already. docs/notes/prior.md
RATE, DRAWING_RATE, WARM_UP = 3e-3, 3.0, 3


def with_decoder(
    result: CaptureResult, rectified: Rectified, effort: Effort, clock: CaptureClock
) -> CaptureResult:
    """A capture by example with a decoder added, and the nearer one chosen as default.

    After Ctrl-C it is the capture by example alone.

    Args:
        result: of a capture by example of one photograph.
        rectified: the photograph, lying.
        effort: steps and windows.
    """
    try:
        (tuned, decoded), tuning, target, plane = _tuned(result, rectified, effort, clock)
        with clock.stage("choice"):
            generators = {**result.material.generators, "decoder": tuned}
            both = replace(result.material, generators=generators)
            one, other = (maps.turned(int(tuned.turned)) for maps in (result.maps, decoded))
            choice = replace(choose(one, other, target, plane), decoded=decoded)
    except KeyboardInterrupt:
        clock.status = RunStatus.INTERRUPTED
    if clock.status is RunStatus.INTERRUPTED:
        return replace(result, status=clock.status)
    material = both.preferring(choice.generator)
    return replace(result, status=clock.status, material=material, tuning=tuning, choice=choice)


def _tuned(
    result: CaptureResult, rectified: Rectified, effort: Effort, clock: CaptureClock
) -> tuple[tuple[TunedDecoder, MapSet], Tuning, PhotographTarget, Plane]:
    """The decoder and maps of its field, as large as the photograph; both upright as the material.

    And the course of fine-tuning, and what it was tuned to.
    """
    estimate, settings, latent = result.estimate, result.settings, result.material.latent
    assert estimate is not None and latent is not None
    with clock.stage("statistics"):
        drawing = _drawing(rectified, result.material)
        coarse = rectified.coarse.scaled(estimate.scale)
        plane = _at_resolution(rectified, drawing)
        lying = replace(rectified, coarse=coarse, whole=plane, waves=(), network_input=plane)
        most = effort.steps * effort.places
        target = photograph_target(lying, Method(), most)
        unit = self_difference(target.windows, target.weights)
        tune = TuneSettings(
            effort.steps,
            places=effort.places,
            drawing_rate=DRAWING_RATE,
            warm_up=WARM_UP,
            seed=settings.seed,
        )
    with clock.stage("start"):
        base = base_of(coarse, log_contrast(plane.linear, plane.valid))
        start = InitialDecoder(fold(load_drawing_start(), base), latent.code, RATE)
    target = replace(target, drawing=drawing)
    decoder, course = tuned_decoder(plane.texel_size, start, target, tune, clock, unit)
    with clock.stage("matching"):
        decoder = replace(decoder, texel_size=drawing.texel_size)
        upright = replace(coarse.setup, turned=drawing.turned)
        material, maps = match_photograph(decoder.material("", upright), plane, settings.seed)
        part = material.part(TunedDecoder)
        assert part is not None
    return (part, maps), Tuning(course.history, unit, drawing=True), target, plane


def _drawing(rectified: Rectified, material: Material) -> Drawing:
    """The drawing of a material's exemplar at about the network's resolution."""
    example, finer = material.part(Example), 1
    assert example is not None
    while rectified.whole.size[0] > finer * rectified.network_input.size[0]:
        finer *= 2
    return Drawing(example, finer, material.setup.turned)


def _at_resolution(rectified: Rectified, drawing: Drawing) -> Plane:
    columns = rectified.whole.size[0] // drawing.finer
    if columns == rectified.network_input.size[0]:
        return rectified.network_input
    return rectified.whole.shrunk(columns)


# Windows of both fields, at the decoder's resolution, are rendered where the photograph's windows
# are, and compared with these by texture statistics of random filters other than those that the
# decoder is fine-tuned by.

_BANK = FilterBankConfig(sizes=(3, 7), filters=24, seed=7)
_COMPARED = 24  # windows
_AT_ONCE = 4  # windows
# Factor on the decoder's distance. Of eleven materials whose truth is known, four decoders came out
# nearer, by up to a fifth, that were farther (docs/notes/prior.md): the exemplar is kept then.
_BIAS = 1.25


def choose(
    by_example: MapSet, by_decoder: MapSet, target: PhotographTarget, plane: Plane
) -> GeneratorChoice:
    """The generator whose field is nearer to the photograph, the decoder only with as many texels.

    Args:
        by_example: maps of a field as large as the photograph, lying.
        by_decoder: the same of the other generator.
        target: camera, flash and encoding of the photograph.
        plane: the photograph at the resolution of `by_decoder`.
    """
    bank, size = FilterBank(_BANK), target.windows.size
    windows = cut_windows(plane, bank, size, most=_COMPARED)
    compared = replace(target, windows=windows, bank=bank, drawing=None)
    fields: dict[Generator, MapSet] = {"example": by_example, "decoder": by_decoder}
    distances = {
        name: _distance(_pieces(maps.stacked(), by_decoder.size[0], size), compared)
        for name, maps in fields.items()
    }
    # With fewer texels the decoder would lose detail, which windows at its resolution do not show.
    as_fine = by_example.size == by_decoder.size
    nearer = as_fine and _BIAS * distances["decoder"] < distances["example"]
    return GeneratorChoice("decoder" if nearer else "example", distances, by_decoder)


def _pieces(maps: Tensor, columns: int, size: int) -> Tensor:
    """(N, C, size, size) of stacked maps (C, H, W), averaged to `columns` across."""
    finer = maps.shape[-1] // columns
    coarse = F.avg_pool2d(maps, finer) if finer > 1 else maps
    pieces = coarse.unfold(1, size, size).unfold(2, size, size)
    return pieces.flatten(1, 2).transpose(0, 1)


@torch.inference_mode()
def _distance(pieces: Tensor, target: PhotographTarget) -> float:
    """Mean texture distance of a field's windows, each at a window of the photograph."""
    errors, count = [], target.windows.count
    for number, places in enumerate(torch.arange(count).split(_AT_ONCE)):
        maps = MapSet.from_stacked(pieces[places % len(pieces)], target.texel_size)
        rendered = render_windows(maps, target, places, number)
        compared = compare_windows(rendered, target, places, half_precision=False)
        errors.append(len(places) * float(compared))
    return sum(errors) / count
