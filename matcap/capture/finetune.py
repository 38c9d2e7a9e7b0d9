"""Fine-tuning: the decoder learns to look like the photograph, window by window (paper, 4.6).

Each step decodes fresh noise, renders it as if it lay at a few places of the photograph, and
compares every rendering's statistics with the photograph's at that same place. The sensor's noise
is added to the rendering first, so that the material need not imitate it. The last steps run
with AdaIN's statistics frozen, so that what is saved is what was optimised.

Anytime: it ends after a number of steps, a time, at an error, or by an interrupt, and hands back
the best so far.
A step that goes wrong (a loss or a gradient that is not finite, a loss that explodes) is taken
back and the rate lowered.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.optim.adam import adam

from matcap.brdf.maps import MapSet
from matcap.capture.windows import Windows, shot_deviation
from matcap.flash.geometry import FlashSetup
from matcap.flash.render import render_flash
from matcap.model.decoder import ALIGNMENT, DEPTH, Decoder, Moments, maps_from_raw
from matcap.model.freeze import freeze
from matcap.model.noise import wrap64
from matcap.model.random_field import RandomField, random_field
from matcap.statistics.compare import Features, Weights, describe, distance
from matcap.statistics.encoding import Encoding
from matcap.statistics.lattice import Wave

# Of learning: a decoder that knows textures already is only to be moved a little.
RATE_FROM_NOTHING, RATE_FROM_PRIOR = 2e-2, 1e-2

_WARM_UP = 10  # steps
_FLOOR = 0.05  # of the learning rate, at the end of the cosine
_FROZEN_SHARE = 0.15  # of the work, at the end, done with frozen statistics
_SMOOTHING = 0.05  # of the running error
_EXPLODED = 4.0  # times the running error
_SNAPSHOT_EVERY = 20  # steps
# How far the coarse fit's diffuse albedo, F0 and roughness are believed, in logits: the texture's
# bumps widen the highlight, so its roughness tells little.
_BELIEF = (0.4, 0.4, 0.4, 0.6, 2.0)
_LOGIT_EPSILON = 1e-4
# Specks are paid for once half of the work is done: what belongs there, as metal between rust,
# begins as specks too, and has spread by then.
_OUTLIERS_FROM = 0.5  # share of the work
_OUTLIER = 4.0  # standard deviations of a map
_EVEN = 0.05  # added to the standard deviation: an even map has none
_STEEP = 1.0  # slopes beyond 45 degrees are not relief a flash photograph shows


@dataclass(frozen=True)
class TuneSettings:
    """How long and how fast.

    Attributes:
        steps: at most so many.
        seconds: and at most so long, or None.
        target: running error at which only the frozen end is left to be done, or None.
        places: windows rendered per step.
        learning_rate: of Adam, at its highest.
        slope_penalty: of the mean squared slope; relief must pay for itself.
        specular_penalty, roughness_penalty: of their logits' variance; what diffuse albedo
            explains as well is not to become blotches of gloss.
        outlier_penalty: of texels beyond _OUTLIER standard deviations of diffuse albedo, F0 or
            roughness, in their squared excess; few of them do not show in the statistics.
        departure_penalty: of mean maps that leave the coarse fit, in its squared deviations.
        steep_penalty: of squared slopes beyond 45 degrees.
        half_precision: bfloat16 inside the network and the features.
        seed: of noise and order.
    """

    steps: int
    seconds: float | None = None
    target: float | None = None
    places: int = 1
    learning_rate: float = RATE_FROM_NOTHING
    slope_penalty: float = 0.005
    specular_penalty: float = 0.02
    roughness_penalty: float = 0.01
    departure_penalty: float = 0.003
    outlier_penalty: float = 0.05
    steep_penalty: float = 0.3
    half_precision: bool = True
    seed: int = 0


@dataclass(frozen=True)
class Scene:
    """What the decoder is tuned to: one photograph.

    Attributes:
        windows: places and targets.
        setup: camera and flash.
        encoding: of its colours.
        bank: features.
        waves: of its regular order.
        texel_size: in plane units.
        weights: of the statistics.
        expected: (5,) logits of the coarse fit's diffuse albedo, F0 and roughness, or None.
    """

    windows: Windows
    setup: FlashSetup
    encoding: Encoding
    bank: Features
    waves: tuple[Wave, ...]
    texel_size: float
    weights: Weights = Weights()
    expected: Tensor | None = None


@dataclass(frozen=True)
class Tuned:
    """The best decoder found.

    Attributes:
        decoder: its weights.
        moments: frozen statistics it was optimised with.
        history: (seconds, step, running error) as it went.
        interrupted: ended by Ctrl-C.
    """

    decoder: Decoder
    moments: tuple[Moments, ...]
    history: tuple[tuple[float, int, float], ...]
    interrupted: bool


Report = Callable[[float, float, float], None]  # share done, running error, seconds so far


def finetune(
    decoder: Decoder, code: Tensor, scene: Scene, settings: TuneSettings, report: Report
) -> Tuned:
    """Tune a decoder at a code to a photograph. The decoder given is changed.

    Args:
        decoder: where to start.
        code: (CODE_SIZE,), held fixed.
        scene: the photograph.
        settings: how long and how fast.
        report: called after every step.
    """
    if not settings.steps:
        return Tuned(decoder, tuple(freeze(decoder, code, scene.waves)), (), False)
    started = time.monotonic()
    optimiser = _Adam(decoder)
    order = _places(scene.windows.count, settings.seed)
    moments: list[Moments] | None = None
    best = _Best(copy.deepcopy(decoder.state_dict()), math.inf)
    error, rate, step, history = math.nan, settings.learning_rate, 0, []
    steps = settings.steps
    interrupted = False
    try:
        while True:
            seconds = time.monotonic() - started
            good = settings.target is not None and error <= settings.target
            if good and moments is None and step >= _WARM_UP:
                steps = min(steps, math.ceil(step / (1.0 - _FROZEN_SHARE)))
            share = step / steps
            if settings.seconds is not None:
                share = max(share, seconds / settings.seconds)
            if share >= 1.0:
                break
            if moments is None and share >= 1.0 - _FROZEN_SHARE:
                moments = freeze(decoder, code, scene.waves)
                best = _Best(copy.deepcopy(decoder.state_dict()), math.inf)
            places = torch.tensor([next(order) for _ in range(settings.places)])
            loss, penalty = _step_loss(decoder, code, scene, settings, moments, places, step, share)
            value = float(loss.detach())
            slope = math.nan
            if math.isfinite(value) and not value > _EXPLODED * max(error, 0.1):
                decoder.zero_grad(set_to_none=True)
                (loss + penalty).backward()
                slope = float(torch.nn.utils.clip_grad_norm_(decoder.parameters(), 1.0))
            if not math.isfinite(slope):
                # Back to where it was good, and slower from there.
                decoder.load_state_dict(best.state)
                error = best.error if math.isfinite(best.error) else math.nan
                rate *= 0.5
                optimiser = _Adam(decoder)
                step += 1
                continue
            optimiser.step(rate * _schedule(step, share))
            step += 1
            smoothing = max(_SMOOTHING, 1.0 / step)
            error = value if math.isnan(error) else error + smoothing * (value - error)
            seconds = time.monotonic() - started
            history.append((seconds, step, error))
            if step % _SNAPSHOT_EVERY == 0 and error < best.error:
                best = _Best(copy.deepcopy(decoder.state_dict()), error)
            report(min(1.0, share), error, seconds)
    except KeyboardInterrupt:
        interrupted = True
    if history and best.error < error:
        decoder.load_state_dict(best.state)
    if moments is None or not history:
        moments = freeze(decoder, code, scene.waves)
    return Tuned(decoder, tuple(moments), tuple(history), interrupted)


@dataclass(frozen=True)
class _Best:
    state: dict[str, Tensor]
    error: float


class _Adam:
    """torch.optim.Adam's function without its class, which imports PyTorch's compiler: a second."""

    def __init__(self, decoder: Decoder) -> None:
        self._parameters = [p for p in decoder.parameters() if p.requires_grad]
        self._means = [torch.zeros_like(p) for p in self._parameters]
        self._squares = [torch.zeros_like(p) for p in self._parameters]
        self._steps = [torch.zeros(()) for _ in self._parameters]

    @torch.no_grad()
    def step(self, rate: float) -> None:
        """One step along the gradients there are."""
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


def _schedule(step: int, share: float) -> float:
    """Warm-up, then a cosine down to _FLOOR."""
    warm = min(1.0, (step + 1) / _WARM_UP)
    return warm * (_FLOOR + (1.0 - _FLOOR) * (0.5 + 0.5 * math.cos(math.pi * share)))


def _places(count: int, seed: int) -> Iterator[int]:
    """Every window once in a random order, for ever."""
    generator = torch.Generator().manual_seed(seed)
    while True:
        yield from torch.randperm(count, generator=generator).tolist()


def _step_loss(
    decoder: Decoder,
    code: Tensor,
    scene: Scene,
    settings: TuneSettings,
    moments: list[Moments] | None,
    places: Tensor,
    step: int,
    share: float,
) -> tuple[Tensor, Tensor]:
    """Mean distance at some places, and what the maps pay for being what they need not be."""
    maps = decode_window(
        decoder,
        code,
        scene,
        wrap64(settings.seed * 1_000_003 + step),
        moments,
        half_precision=settings.half_precision,
    )
    rendered = render_flash(maps, scene.setup, scene.windows.points[places])
    if scene.windows.noise is not None:
        rendered = with_noise(rendered, scene.windows.noise[places], step)
    with torch.autocast("cpu", torch.bfloat16, enabled=settings.half_precision):
        found = describe(rendered, scene.encoding, scene.bank)
    loss = distance(found, scene.windows.target.select(places), scene.weights).mean()
    return loss, _penalty(maps, scene.expected, settings, share)


def with_noise(rendered: Tensor, noise: Tensor, step: int) -> Tensor:
    """Renderings (B, 3, size, size) as the sensor saw them.

    The noise (Windows.noise) is another one at every step: moved around, and its sign drawn.
    """
    generator = torch.Generator().manual_seed(step)
    down, across, sign = torch.randint(noise.shape[-1], (3,), generator=generator).tolist()
    moved = noise.roll((down, across), dims=(-2, -1)) * (1.0 if sign % 2 else -1.0)
    return rendered + moved * shot_deviation(rendered.detach())


def _penalty(maps: MapSet, expected: Tensor | None, settings: TuneSettings, share: float) -> Tensor:
    """Relief, variation of F0 and roughness that diffuse albedo explains as well, and specks."""
    normal = maps.normal
    squared = (normal[:, :2] / normal[:, 2:]).square().sum(dim=1)
    steep = torch.relu((squared + 1e-6).sqrt() - _STEEP).square().mean()
    penalty = settings.slope_penalty * squared.mean() + settings.steep_penalty * steep
    specular = torch.logit(maps.specular, eps=_LOGIT_EPSILON)
    roughness = torch.logit(maps.roughness, eps=_LOGIT_EPSILON)
    penalty = penalty + settings.specular_penalty * specular.var()
    penalty = penalty + settings.roughness_penalty * roughness.var()
    if share > _OUTLIERS_FROM:
        diffuse = torch.logit(maps.diffuse, eps=_LOGIT_EPSILON)
        reflectance = torch.cat([diffuse, specular, roughness], dim=1)
        apart = reflectance - reflectance.mean(dim=(0, 2, 3), keepdim=True)
        variance = apart.square().mean(dim=(0, 2, 3), keepdim=True)
        outlying = torch.relu(apart.abs() / (variance + _EVEN**2).sqrt() - _OUTLIER)
        penalty = penalty + settings.outlier_penalty * outlying.square().mean((0, 2, 3)).sum()
    if expected is not None:
        # The fit saw a blurred photograph: what it says is the mean, not the mean of logits.
        linear = torch.cat([maps.diffuse, maps.specular, maps.roughness], dim=1)
        means = torch.logit(linear.mean(dim=(0, 2, 3)), eps=_LOGIT_EPSILON)
        departure = ((means - expected) / expected.new_tensor(_BELIEF)).square().sum()
        penalty = penalty + settings.departure_penalty * departure
    return penalty


def decode_window(
    decoder: Decoder,
    code: Tensor,
    scene: Scene,
    seed: int,
    moments: list[Moments] | None,
    *,
    half_precision: bool,
) -> MapSet:
    """Maps (1, ., size, size) of one window of fresh noise.

    Noise repeats with the rectangle, which is a field as good as any. A material's waves do not
    fit any rectangle; where they break, at the border, a margin is cut off.
    """
    size = scene.windows.size
    margin = ALIGNMENT if scene.waves else 0
    full = size + 2 * margin
    noise = random_field(
        seed, decoder.config.noise_channels, (), 0, 0, full, full, levels=0, period=(full, full)
    ).noise
    cells = decoder.config.cells
    waves = random_field(seed, 1, scene.waves, 0, 0, full, full, levels=DEPTH, cells=cells).waves
    with torch.autocast("cpu", torch.bfloat16, enabled=half_precision):
        raw = decoder(RandomField(noise, waves), code, moments)
    if margin:
        raw = raw[..., margin:-margin, margin:-margin]
    return maps_from_raw(raw, scene.texel_size, periodic=margin == 0)
