"""Fine-tuning of a decoder to a photograph [henzler2021, sec. 4.6]: schedule, penalties, start."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor
from torch.optim.adam import adam

from matcap.brdf.maps import MapSet
from matcap.field.field import computes_bfloat16
from matcap.field.plane import Rectangle
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.rectify import Plane
from matcap.space.decoder import (
    CODE_SIZE,
    DEPTH,
    EPSILON,
    ConvolutionLayer,
    Decoder,
    DecoderConfig,
    Moments,
    maps_from_raw,
)
from matcap.space.freeze import freeze
from matcap.space.prior.store import load_prior
from matcap.space.random_field import (
    CELL_CHANNELS,
    Patch,
    RandomField,
    lattice_levels,
    noise_field,
    wrap64,
)
from matcap.space.tuning.match import (
    MARGIN,
    Lesson,
    PhotographTarget,
    Teacher,
    compare_windows,
    log_contrast,
    reading_cells,
    render_windows,
    shuffled,
    untrained,
)

# Schedule of fine-tuning: end, freezing and learning rate.

# Settings of every optimisation run; docs/notes/prior.md.
WARM_UP = 10  # steps of linear warm-up of the learning rate
_FLOOR = 0.05  # final share of the learning rate
_FROZEN_SHARE = 0.15  # last share of the run, with frozen statistics


class Schedule:
    """Progress of a run, which ends by steps or by time, whichever is first.

    Attributes:
        step: number of completed steps.
        share: completed share of the run, in [0, 1], updated by `over`.
    """

    def __init__(self, steps: int, seconds: float | None, warm_up: int = WARM_UP) -> None:
        """Start the clock.

        Args:
            steps: largest number of steps.
            seconds: time limit, or None.
            warm_up: steps of linear warm-up of the learning rate.
        """
        self.step, self.share = 0, 0.0
        self._steps, self._limit, self._warm_up = steps, seconds, warm_up
        self._started = time.monotonic()

    def over(self) -> bool:
        """Update `share` from steps and clock; whether the run is done."""
        self.share = self.step / self._steps
        if self._limit is not None:
            self.share = max(self.share, self.seconds / self._limit if self._limit > 0.0 else 1.0)
        return self.share >= 1.0

    @property
    def seconds(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self._started

    @property
    def freezes(self) -> bool:
        """Whether the remaining steps use frozen statistics."""
        return self.share >= 1.0 - _FROZEN_SHARE

    @property
    def pace(self) -> float:
        """Share of the learning rate: a warm-up, then a cosine down to _FLOOR."""
        warm = min(1.0, (self.step + 1) / self._warm_up)
        return warm * (_FLOOR + (1.0 - _FLOOR) * (0.5 + 0.5 * math.cos(math.pi * self.share)))


# Batch renormalisation [ioffe2017] of AdaIN, for windows smaller than the texture's variation.
#
# AdaIN normalises every window by its own moments M, S, which removes what one window has and
# another has not: the clouds of a drawing. With running moments m, s over all windows so far, it is
# undone:
#
# (x - M) / S * r + d,    r = S / s,    d = (M - m) / s,
#
# where r and d are constants of the gradient, which therefore is AdaIN's and as stable; the values
# are those of frozen statistics. At first r = 1 and d = 0; their limits widen with the steps.

_NEWEST = 0.1  # weight of a window in the running moments
_BEGIN, _END = 0.1, 0.4  # shares of fine-tuning between which limits widen
_MOST_RATIO, _MOST_SHIFT = 2.0, 5.0  # final limits of r - 1 (or 1 / r - 1) and of |d|


class Renormalisation:
    """Running moments of every layer of a decoder that is fine-tuned."""

    def __init__(self) -> None:
        self._running: dict[ConvolutionLayer, tuple[Tensor, Tensor]] = {}

    def decode(self, decoder: Decoder, field: RandomField, code: Tensor, share: float) -> Tensor:
        """Raw outputs as of Decoder.forward; `share` of fine-tuning is complete."""
        wide = min(1.0, max(0.0, (share - _BEGIN) / (_END - _BEGIN)))

        def adapt(layer: ConvolutionLayer, features: Tensor) -> Tensor:
            ratio, shift = self._correction(layer, features.detach().float(), wide)
            mean, deviation = (target.float() for target in layer.adain.target(code))
            scale, offset = deviation * ratio, mean + deviation * shift
            return F.batch_norm(features, None, None, scale, offset, True, 0.0, EPSILON)

        return decoder.run(field, adapt)

    def _correction(
        self, layer: ConvolutionLayer, features: Tensor, wide: float
    ) -> tuple[Tensor, Tensor]:
        """Ratio r and shift d of a layer, (C,) each, for its input (1, C, H, W)."""
        variance, own = torch.var_mean(features, (0, 2, 3), correction=0)
        square = variance + own.square()
        mean, mean_square = self._running.get(layer, (own, square))
        mean, mean_square = mean.lerp(own, _NEWEST), mean_square.lerp(square, _NEWEST)
        self._running[layer] = (mean, mean_square)
        deviation = ((mean_square - mean.square()).clamp_min(0.0) + EPSILON).sqrt()
        most = 1.0 + _MOST_RATIO * wide
        ratio = ((variance + EPSILON).sqrt() / deviation).clamp(1.0 / most, most)
        bound = _MOST_SHIFT * wide
        return ratio, ((own - mean) / deviation).clamp(-bound, bound)


# Regularisers of maps: penalties on structure that the photograph does not need.

_LOGIT_EPSILON = 1e-4  # of albedo, F0 and roughness: bounds the logit at 0 and 1

# Weights of the penalties added to the texture distance; docs/notes/prior.md.
_SLOPE = 0.005  # of the mean squared slope
# Of the variances of their logits, so that diffuse albedo is preferred where it explains the
# photograph as well.
_SPECULAR, _ROUGHNESS = 0.02, 0.01
_DEPARTURE = 0.003  # of the squared difference of mean maps from the coarse fit
# Of the squared excess of texels over _OUTLYING standard deviations, in logits of diffuse albedo,
# F0 and roughness; the statistics do not see few of them.
_OUTLIER, _OUTLYING = 0.05, 4.0
# Share of the steps before outliers are penalised, as real features (metal between rust) also begin
# as specks.
_OUTLIERS_FROM = 0.5
_EVEN = 0.05  # logits, added in quadrature to the standard deviation of a map
_STEEP = 0.3  # of the squared excess of slopes over _STEEPEST
_STEEPEST = 1.0  # 45 degrees, the steepest slope that a flash photograph shows
# Standard deviations of the coarse fit's logits of diffuse albedo (3), F0 and roughness; the last
# is large because relief widens the highlight, which biases roughness.
_FIT_DEVIATION = (0.4, 0.4, 0.4, 0.6, 2.0)


def map_penalty(maps: MapSet, expected: Tensor | None, share: float) -> Tensor:
    """Penalty of maps (B, ., H, W), a differentiable scalar.

    Args:
        expected: (5,) logits of the coarse fit's diffuse albedo, F0 and roughness, or None.
        share: completed share of the steps, in [0, 1].
    """
    normal = maps.normal
    squared = (normal[:, :2] / normal[:, 2:]).square().sum(dim=1)
    steep = torch.relu((squared + 1e-6).sqrt() - _STEEPEST).square().mean()
    penalty = _SLOPE * squared.mean() + _STEEP * steep
    # A coloured F0 is averaged over channels, as the coarse fit's is achromatic.
    maps = replace(maps, specular=maps.specular.mean(dim=1, keepdim=True))
    specular = torch.logit(maps.specular, eps=_LOGIT_EPSILON)
    roughness = torch.logit(maps.roughness, eps=_LOGIT_EPSILON)
    penalty = penalty + _SPECULAR * specular.var()
    penalty = penalty + _ROUGHNESS * roughness.var()
    if share > _OUTLIERS_FROM:
        diffuse = torch.logit(maps.diffuse, eps=_LOGIT_EPSILON)
        penalty = penalty + _OUTLIER * _outlying([diffuse, specular, roughness])
    if expected is not None:
        penalty = penalty + _DEPARTURE * _departure(maps, expected)
    return penalty


def _outlying(logits: list[Tensor]) -> Tensor:
    """Mean squared excess of outliers, summed over channels, in standard deviations."""
    reflectance = torch.cat(logits, dim=1)
    deviation = reflectance - reflectance.mean(dim=(0, 2, 3), keepdim=True)
    variance = deviation.square().mean(dim=(0, 2, 3), keepdim=True)
    outlying = torch.relu(deviation.abs() / (variance + _EVEN**2).sqrt() - _OUTLYING)
    return outlying.square().mean((0, 2, 3)).sum()


def _departure(maps: MapSet, expected: Tensor) -> Tensor:
    """Squared standardised difference of mean maps from the coarse fit."""
    # The fit is to a blurred photograph, so it estimates means of maps, not of logits.
    linear = torch.cat([maps.diffuse, maps.specular, maps.roughness], dim=1)
    means = torch.logit(linear.mean(dim=(0, 2, 3)), eps=_LOGIT_EPSILON)
    return ((means - expected) / expected.new_tensor(_FIT_DEVIATION)).square().sum()


# Optimiser of fine-tuning: Adam with clipped gradients, without the steps that are not finite.

_SMOOTHING = 0.05  # weight of the newest step in the running error
# Factor on the rate of the weights that read a drawing, which start at zero.
DRAWING_RATE = 9.0
_LONGEST_GRADIENT = 1.0  # norm over all weights to which gradients are clipped


class Optimiser:
    """Takes steps of a decoder, and leaves out those whose loss or gradient is not finite.

    Attributes:
        error: running mean of the loss; NaN before the first step.
    """

    def __init__(self, decoder: Decoder, rate: float, drawing_rate: float = DRAWING_RATE) -> None:
        self._decoder, self.error = decoder, math.nan
        self._rate, self._taken, self._adam = rate, 0, Adam(decoder, drawing_rate)

    def take(self, loss: Tensor, penalty: Tensor, pace: float) -> bool:
        """Take a step; return whether it was taken.

        Args:
            loss: texture distance, whose running mean is the error.
            pace: share of the learning rate.
        """
        value = float(loss.detach())
        if not math.isfinite(value):
            return False
        self._decoder.zero_grad(set_to_none=True)
        (loss + penalty).backward()
        norm = torch.nn.utils.clip_grad_norm_(self._decoder.parameters(), _LONGEST_GRADIENT)
        if not math.isfinite(float(norm)):
            return False
        self._adam.step(self._rate * pace)
        self._taken += 1
        before = value if math.isnan(self.error) else self.error
        self.error = before + max(_SMOOTHING, 1.0 / self._taken) * (value - before)
        return True


class Adam:
    """Adam [kingma2015] by torch.optim's function; its class imports PyTorch's compiler (1 s)."""

    def __init__(self, decoder: Decoder, drawing_rate: float = DRAWING_RATE) -> None:
        """Start with zero moments; steps change the decoder's weights in place.

        Those that read the drawing have the rate times `drawing_rate`.
        """
        self._drawing_rate = drawing_rate
        self._parameters = [p for p in decoder.parameters() if p.requires_grad]
        self._drawing = decoder.drawing_weights()
        self._means = [torch.zeros_like(p) for p in self._parameters]
        self._squares = [torch.zeros_like(p) for p in self._parameters]
        self._steps = [torch.zeros(()) for _ in self._parameters]

    @torch.no_grad()
    def step(self, rate: float) -> None:
        """Take a step for all parameters that have a gradient; `rate` is the learning rate."""
        before = [weights.clone() for weights in self._drawing]
        had = [i for i, p in enumerate(self._parameters) if p.grad is not None]
        adam(
            [self._parameters[i] for i in had],
            [self._parameters[i].grad for i in had],  # type: ignore[misc]
            [self._means[i] for i in had],
            [self._squares[i] for i in had],
            [],
            [self._steps[i] for i in had],
            fused=True,
            amsgrad=False,
            beta1=0.9,
            beta2=0.99,
            lr=rate,
            weight_decay=0.0,
            eps=1e-8,
            maximize=False,
        )
        for weights, old in zip(self._drawing, before, strict=True):
            weights.copy_(old.lerp(weights, self._drawing_rate))


# Fine-tuning of a decoder to a photograph [henzler2021, sec. 4.6].
#
# Each step decodes new noise, renders the maps under the flash at a few positions of the
# photograph, and minimises the distance of the renderings' texture statistics to those of the
# photograph at the same positions. Sensor noise is added to the renderings, so that the decoder
# does not learn it. A decoder that reads a drawing is taught by the exemplar's maps, too
# (match.py), and its AdaIN normalises by more than one window (Renormalisation). The last steps
# use frozen AdaIN statistics, so that the saved network is the optimised one.
#
# It ends after a number of steps or a time (Schedule), or by an interrupt.

# Learning rates. At a higher rate 100 steps lose colours that the prior has (docs/notes/prior.md).
RATE_FROM_NOTHING, RATE_FROM_PRIOR, RATE_WITH_DRAWING = 2e-2, 2.5e-3, 5e-3

_SEED_STRIDE = 1_000_003  # between seeds, so that runs share no noise


@dataclass(frozen=True)
class TuneSettings:
    """Limits and rates of fine-tuning."""

    steps: int
    """Largest number of steps."""
    seconds: float | None = None
    """Most seconds, or None."""
    places: int = 1
    """Windows rendered per step."""
    learning_rate: float = RATE_FROM_NOTHING
    """Highest learning rate of Adam."""
    drawing_rate: float = DRAWING_RATE
    """Factor on it of the weights that read a drawing."""
    warm_up: int = WARM_UP
    """Steps of linear warm-up of the learning rate."""
    half_precision: bool = True
    """Use bfloat16 in network and features, on processors with bfloat16 instructions."""
    seed: int = 0
    """Seed of noise and lattice."""


@dataclass(frozen=True)
class Tuned:
    """The fine-tuned decoder."""

    decoder: Decoder
    """The fine-tuned decoder, the same as given."""
    moments: tuple[Moments, ...]
    """Frozen statistics it was optimised with."""
    history: tuple[tuple[float, int, float], ...]
    """(seconds, step, running error) of every step."""
    interrupted: bool
    """Whether Ctrl-C ended it."""


OnStep = Callable[[float, float, float], None]  # share done, running error, seconds


def finetune(
    decoder: Decoder, code: Tensor, scene: PhotographTarget, settings: TuneSettings, report: OnStep
) -> Tuned:
    """Fine-tune a decoder to a photograph, in place.

    Args:
        code: (CODE_SIZE,) latent vector, fixed.
        report: called after every step.
    """
    if not settings.steps:
        return Tuned(decoder, tuple(freeze(decoder, code, scene.waves, scene.drawing)), (), False)
    schedule = Schedule(settings.steps, settings.seconds, settings.warm_up)
    optimiser = Optimiser(decoder, settings.learning_rate, settings.drawing_rate)
    order = shuffled(scene.windows.count, settings.seed)
    half, drawing = settings.half_precision, scene.drawing
    teacher = None if drawing is None else Teacher.of(drawing, scene.windows.size, settings.seed)
    renormalised = Renormalisation()
    moments: list[Moments] | None = None

    def decode(field: RandomField) -> Tensor:
        if moments is None and teacher is not None:
            return renormalised.decode(decoder, field, code, schedule.share)
        return decoder(field, code, moments)

    history: list[tuple[float, int, float]] = []
    interrupted = False
    try:
        while not schedule.over():
            if moments is None and schedule.freezes:
                moments = freeze(decoder, code, scene.waves, drawing)
            places = torch.tensor([next(order) for _ in range(settings.places)])
            seed = wrap64(settings.seed * _SEED_STRIDE + schedule.step)
            lesson = None if teacher is None else teacher.lesson(seed)
            maps = decode_window(decoder.config, decode, scene, seed, lesson, half_precision=half)
            rendered = render_windows(maps, scene, places, schedule.step)
            loss = compare_windows(rendered, scene, places, half_precision=half)
            penalty = map_penalty(maps, scene.expected, schedule.share)
            if lesson is not None:
                penalty = penalty + lesson.loss(maps)
            taken = optimiser.take(loss, penalty, schedule.pace)
            schedule.step += 1
            if taken:
                history.append((schedule.seconds, schedule.step, optimiser.error))
                report(min(1.0, schedule.share), optimiser.error, history[-1][0])
    except KeyboardInterrupt:
        interrupted = True
    if moments is None or not history:
        moments = freeze(decoder, code, scene.waves, drawing)
    return Tuned(decoder, tuple(moments), tuple(history), interrupted)


def decode_window(
    config: DecoderConfig,
    decode: Callable[[RandomField], Tensor],
    scene: PhotographTarget,
    seed: int,
    lesson: Lesson | None = None,
    *,
    half_precision: bool,
) -> MapSet:
    """Maps (1, ., size, size) of a window of new noise, decoded as a torus.

    A lattice or drawing does not repeat with the window; with one, a margin around the window is
    decoded and cut off.
    """
    size = scene.windows.size
    margin = MARGIN if scene.waves or lesson else 0
    full = size + 2 * margin
    patch = Patch(seed, Rectangle(0, 0, full, full))
    noise = noise_field(replace(patch, period=(full, full)), config.noise_channels)[None]
    waves = lattice_levels(patch, scene.waves, config.cells, DEPTH) if scene.waves else ()
    with torch.autocast("cpu", torch.bfloat16, enabled=half_precision and computes_bfloat16()):
        drawing = () if lesson is None else lesson.drawing
        raw = decode(RandomField(noise, waves, drawing))
    if margin:
        raw = raw[..., margin:-margin, margin:-margin]
    return maps_from_raw(raw, scene.texel_size, periodic=margin == 0)


# The decoder that fine-tuning starts from: the prior's, or a random one.


@dataclass(frozen=True)
class InitialDecoder:
    """Initial state of fine-tuning."""

    decoder: Decoder
    code: Tensor
    """(CODE_SIZE,) latent vector."""
    rate: float


def initial_decoder(
    pixels: NDArray[np.float32],
    coarse: CoarseFit,
    plane: Plane,
    target: PhotographTarget,
    tune: TuneSettings,
    prior: str,
    shape: DecoderConfig,
) -> InitialDecoder:
    """Choose the decoder, latent vector and learning rate that fine-tuning starts from.

    Args:
        pixels: (H, W, 3) linear, of the photograph as taken.
        coarse, plane: of the photograph, the plane at the capture's resolution.
        prior: "auto" (the shipped one), "none" (a random decoder) or a file.
        shape: configuration of a random decoder.

    Raises:
        MatcapError: the prior cannot be read.
    """
    if prior == "none":
        shape = replace(shape, cells=CELL_CHANNELS if target.waves else 0)
        contrast = log_contrast(plane.linear, plane.valid)
        decoder = untrained(shape, coarse, contrast, tune.seed)
        return InitialDecoder(decoder, torch.zeros(CODE_SIZE), RATE_FROM_NOTHING)
    trained = load_prior(None if prior == "auto" else Path(prior))
    decoder, code = trained.start(pixels, coarse, plane)
    if target.waves and tune.steps:  # without a step, random weights would only add noise
        decoder = reading_cells(decoder, tune.seed)
    return InitialDecoder(decoder.requires_grad_(True), code, RATE_FROM_PRIOR)
