"""Fine-tuning: the decoder learns to look like the photograph, window by window (paper, 4.6).

Each step decodes fresh noise, renders it as if it lay at a few places of the photograph, and
compares every rendering's statistics with the photograph's at that same place. The sensor's noise
is added to the rendering first, so that the material need not imitate it. The last steps run
with AdaIN's statistics frozen, so that what is saved is what was optimised.

Anytime: it ends after a number of steps, a time, at an error (schedule.py), or by an interrupt,
and hands back the best so far (rollback.py). Penalties on maps are in penalty.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.field.plane import Rectangle
from matcap.flash.likeness import PhotographTarget, compare_windows, render_windows, shuffled
from matcap.flash.penalty import Penalties, price
from matcap.flash.schedule import Schedule
from matcap.space.decoder import ALIGNMENT, DEPTH, Decoder, Moments, maps_from_raw
from matcap.space.freeze import freeze
from matcap.space.noise import wrap64
from matcap.space.patch import Patch
from matcap.space.random_field import RandomField, random_field
from matcap.space.tuning.rollback import Rollback
from matcap.statistics.precision import computes_bfloat16

# Of learning: a decoder that knows textures already is only to be moved a little; faster, and 100
# steps lose colours that it had (docs/notes/prior.md).
RATE_FROM_NOTHING, RATE_FROM_PRIOR = 2e-2, 2.5e-3

_SEED_STRIDE = 1_000_003  # runs of different seeds share no noise


@dataclass(frozen=True)
class TuneSettings:
    """How long and how fast."""

    steps: int
    """At most so many."""
    seconds: float | None = None
    """And at most so long, or None."""
    target: float | None = None
    """Running error at which only the frozen end is left to be done, or None."""
    places: int = 1
    """Windows rendered per step."""
    learning_rate: float = RATE_FROM_NOTHING
    """Of Adam, at its highest."""
    penalties: Penalties = Penalties()
    """Weights of the penalties added to the distance."""
    half_precision: bool = True
    """bfloat16 inside the network and the features, on processors that compute with it."""
    seed: int = 0
    """Of noise and order."""


@dataclass(frozen=True)
class Tuned:
    """The best decoder found."""

    decoder: Decoder
    """Its weights."""
    moments: tuple[Moments, ...]
    """Frozen statistics it was optimised with."""
    history: tuple[tuple[float, int, float], ...]
    """(seconds, step, running error) as it went."""
    interrupted: bool
    """Ended by Ctrl-C."""


OnStep = Callable[[float, float, float], None]  # share done, running error, seconds so far


def finetune(
    decoder: Decoder,
    code: Tensor,
    scene: PhotographTarget,
    settings: TuneSettings,
    report: OnStep,
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
    schedule = Schedule(settings.steps, settings.seconds, settings.target)
    guard = Rollback(decoder, settings.learning_rate)
    order = shuffled(scene.windows.count, settings.seed)
    half = settings.half_precision
    moments: list[Moments] | None = None
    history: list[tuple[float, int, float]] = []
    interrupted = False
    try:
        while not schedule.over(guard.error):
            if moments is None and schedule.freezes:
                moments = freeze(decoder, code, scene.waves)
                guard.begin_again()
            places = torch.tensor([next(order) for _ in range(settings.places)])
            seed = wrap64(settings.seed * _SEED_STRIDE + schedule.step)
            maps = decode_window(decoder, code, scene, seed, moments, half_precision=half)
            rendered = render_windows(maps, scene, places, schedule.step)
            loss = compare_windows(rendered, scene, places, half_precision=half)
            penalty = price(maps, scene.expected, settings.penalties, schedule.share)
            well = guard.take(loss, penalty, schedule.pace)
            schedule.step += 1
            if well:
                history.append((schedule.seconds, schedule.step, guard.error))
                report(min(1.0, schedule.share), guard.error, history[-1][0])
    except KeyboardInterrupt:
        interrupted = True
    guard.finish()
    if moments is None or not history:
        moments = freeze(decoder, code, scene.waves)
    return Tuned(decoder, tuple(moments), tuple(history), interrupted)


def decode_window(
    decoder: Decoder,
    code: Tensor,
    scene: PhotographTarget,
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
        Patch(seed, Rectangle(0, 0, full, full), period=(full, full)),
        decoder.config.noise_channels,
        (),
        levels=0,
        grains=decoder.config.grains,
    ).noise
    cells = decoder.config.cells
    waves = random_field(
        Patch(seed, Rectangle(0, 0, full, full)), 1, scene.waves, levels=DEPTH, cells=cells
    ).waves
    with torch.autocast("cpu", torch.bfloat16, enabled=half_precision and computes_bfloat16()):
        raw = decoder(RandomField(noise, waves), code, moments)
    if margin:
        raw = raw[..., margin:-margin, margin:-margin]
    return maps_from_raw(raw, scene.texel_size, periodic=margin == 0)
