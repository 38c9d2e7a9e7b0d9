"""Fine-tuning of a decoder to a photograph [henzler2021, sec. 4.6].

Each step decodes new noise, renders the maps under the flash at a few positions of the photograph,
and minimises the distance of the renderings' texture statistics to those of the photograph at the
same positions. Sensor noise is added to the renderings, so that the decoder does not learn it. A
decoder that reads a drawing is taught by the exemplar's maps, too (teacher.py), and its AdaIN
normalises by more than one window (renormalise.py). The
last steps use frozen AdaIN statistics, so that the saved network is the optimised one.

It ends after a number of steps or a time (schedule.py), or by an interrupt.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.field.device import computes_bfloat16
from matcap.field.plane import Rectangle
from matcap.space.decoder import DEPTH, Decoder, DecoderConfig, Moments, maps_from_raw
from matcap.space.freeze import freeze
from matcap.space.noise import noise_field, wrap64
from matcap.space.patch import Patch
from matcap.space.random_field import RandomField, lattice_levels
from matcap.space.tuning.likeness import PhotographTarget, compare_windows, render_windows, shuffled
from matcap.space.tuning.penalty import Penalties, map_penalty
from matcap.space.tuning.renormalise import Renormalisation
from matcap.space.tuning.rollback import Optimiser
from matcap.space.tuning.schedule import Schedule
from matcap.space.tuning.teacher import MARGIN, Lesson, Teacher

# Learning rates. At a higher rate 100 steps lose colours that the prior has (docs/notes/prior.md).
RATE_FROM_NOTHING, RATE_FROM_PRIOR, RATE_WITH_DRAWING = 2e-2, 2.5e-3, 5e-3

_SEED_STRIDE = 1_000_003  # between seeds, so that runs share no noise


@dataclass(frozen=True)
class TuneSettings:
    """Limits, rates and penalties of fine-tuning."""

    steps: int
    """Largest number of steps."""
    seconds: float | None = None
    """Most seconds, or None."""
    places: int = 1
    """Windows rendered per step."""
    learning_rate: float = RATE_FROM_NOTHING
    """Highest learning rate of Adam."""
    penalties: Penalties = Penalties()
    """Weights of the penalties on maps."""
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
    decoder: Decoder,
    code: Tensor,
    scene: PhotographTarget,
    settings: TuneSettings,
    report: OnStep,
) -> Tuned:
    """Fine-tune a decoder to a photograph, in place.

    Args:
        code: (CODE_SIZE,) latent vector, fixed.
        report: called after every step.
    """
    if not settings.steps:
        return Tuned(decoder, tuple(freeze(decoder, code, scene.waves, scene.drawing)), (), False)
    schedule = Schedule(settings.steps, settings.seconds)
    optimiser = Optimiser(decoder, settings.learning_rate)
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
            penalty = map_penalty(maps, scene.expected, settings.penalties, schedule.share)
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
    waves = lattice_levels(patch, scene.waves, config.cells, DEPTH)
    with torch.autocast("cpu", torch.bfloat16, enabled=half_precision and computes_bfloat16()):
        drawing = () if lesson is None else lesson.drawing
        raw = decode(RandomField(noise, waves, drawing))
    if margin:
        raw = raw[..., margin:-margin, margin:-margin]
    return maps_from_raw(raw, scene.texel_size, periodic=margin == 0)
