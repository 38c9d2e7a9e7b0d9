"""Estimate the exemplar from a rectified photograph: named stages, from values to values.

The network reads the whole picture; what the photograph says outright of relief's strength holds
its answer to the truth; levels and texels are then moved until the maps re-render to the
photograph.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import CHANNELS, MapSet
from matcap.brdf.parameters import SurfaceParameters
from matcap.capture.piece.absolute import most_probable_scale, scaled
from matcap.capture.piece.adapt import Adapted, Change, adapt
from matcap.capture.piece.classes import Classes, find_mixture
from matcap.capture.piece.contrast import even_contrast
from matcap.capture.piece.equalise import equalise
from matcap.capture.piece.finest import finest, sharpness
from matcap.capture.piece.glints import scaled_by_glints
from matcap.capture.piece.levels import LevelPrior, RingTarget, fit_levels
from matcap.capture.piece.metal import metal_share, seen_colour, tint
from matcap.capture.piece.network.inputs import network_inputs
from matcap.capture.piece.network.network import (
    ExpectedErrors,
    Inverse,
    NetworkAnswer,
    NetworkInputs,
)
from matcap.capture.piece.noise import channel_noise
from matcap.capture.piece.photographed_strengths import plane_strengths
from matcap.capture.piece.refine import PieceLight, Refined, flatten, refine, remaining
from matcap.capture.piece.smooth import smoothed
from matcap.capture.piece.strengths import Strengths
from matcap.capture.piece.transport import transport
from matcap.capture.piece.tuned import ADAPT, INPAINT, READ
from matcap.example.example import Example
from matcap.example.exemplar import Exemplar
from matcap.example.variety import chosen
from matcap.flash.coarse import CoarseFit
from matcap.flash.geometry import highlight_foot, plane_points
from matcap.flash.likeness import PhotographTarget
from matcap.flash.plane import Plane
from matcap.flash.rectify import inside
from matcap.statistics.lattice import Wave

if TYPE_CHECKING:
    from matcap.capture.together.set_report import SetReport

Stage = Callable[[str], AbstractContextManager[None]]


@dataclass(frozen=True)
class ExemplarEstimate:
    """The estimate of an exemplar: its maps, and how well they explain the photograph.

    Attributes:
        example: its maps, indexed to be rearranged.
        strengths: what the photograph says of relief and albedo outright, or None.
        error: median difference of log radiance between photograph and re-rendering, of texels
            seen and not clipped.
        slow: mean size of its part that varies slowly, which is not the material's.
        sharpness: strength of the finest octave of log radiance, re-rendering over photograph.
        adaptation: what every leg of it came to; none where it was not asked for.
        interrupted: ended by Ctrl-C.
        several: report on several photographs, where there were.
        scale: of albedo and F0, by which the flash is weaker than the coarse fit has it
            (absolute.py).
        turned: its maps stand upright, as a portrait photograph is looked at (upright.py).
    """

    example: Example
    strengths: Strengths | None
    error: float
    slow: float
    sharpness: float = 1.0
    adaptation: tuple[Change, ...] = ()
    interrupted: bool = False
    several: SetReport | None = None
    scale: float = 1.0
    turned: bool = False

    @property
    def exemplar(self) -> Exemplar:
        """The maps."""
        return self.example.exemplar

    @property
    def framed(self) -> Exemplar:
        """The maps within the photograph's own rectangle."""
        several = self.several
        if several is None or several.reach is None:
            return self.exemplar
        margins, size = several.reach.margins, several.reach.size
        if self.turned:
            margins, size = margins.turned(), size[::-1]
        return self.exemplar.cut(*margins.inside(size))

    def mean_confidence(self, kept: float = 1.0) -> dict[str, float]:
        """By map, of what is the material: `kept` of the photograph."""
        if self.several is not None and self.several.reach is not None:
            kept = self.several.reach.known
        means = np.minimum(self.exemplar.confidence.mean((1, 2)) / np.float32(kept), 1.0).tolist()
        return dict(zip(CHANNELS, means, strict=True))


@dataclass(frozen=True)
class Sight:
    """A photograph of a piece, and its light.

    Attributes:
        plane: the photograph; valid where it was seen and lit.
        coarse: its coarse fit.
        shown: (3, H, W) bool: seen and lit, or beyond the photograph, by channel.
        within: (H, W) bool: the material, in the photograph.
        seen: (H, W) share of each place that was seen, in [0, 1].
        inputs: of the network.
        light: the photograph's, at every texel.
        glare: (H, W) specular fraction of the uniform material's radiance.
        noise: (3, H, W) of log radiance, the sensor's or the codes'.
    """

    plane: Plane
    coarse: CoarseFit
    shown: Tensor
    within: Tensor
    seen: NDArray[np.float32]
    inputs: NetworkInputs
    light: PieceLight
    glare: NDArray[np.float32]
    noise: Tensor

    @staticmethod
    def of(plane: Plane, coarse: CoarseFit) -> Sight:
        """Work out what every stage looks at."""
        width, height = plane.size
        points = plane_points(0, 0, width, height, (width, height), dtype=torch.float32)
        points = plane.extent.placed(points)
        # What lies beyond the photograph is its mirror, not glare.
        rows, columns = plane.margins.inside_of((height, width))
        own = torch.from_numpy(inside((rows, columns), coarse.setup))
        beyond = ~plane.margins.padded(own)
        mirrors = beyond if plane.left_out is None else beyond | plane.left_out
        inputs = network_inputs(plane.linear, plane.valid | mirrors, coarse, points)
        bright = lit(plane.linear)
        measured = plane.measured & bright
        shown = (plane.measured | mirrors) & bright
        plane = replace(plane, valid=plane.valid & bright, channels=measured)
        glare = inputs.gloss[0].clamp(0.0, 1.0).numpy()
        light = PieceLight.of(coarse, points)
        seen = seen_share(measured)
        return Sight(
            plane, coarse, shown, ~mirrors, seen, inputs, light, glare, channel_noise(plane)
        )


@dataclass(frozen=True)
class Reading:
    """Maps of the piece on their way.

    Attributes:
        departures: of the maps from the coarse fit.
        errors: what the network expects to be off by.
        trusted: (4, H, W) confidence of diffuse, specular, roughness and height, in [0, 1].
        logit: (1, H, W) of metal, as the network has it; None where it has hardly any.
        classes: material classes of the texels; of one class until `classified`.
    """

    departures: SurfaceParameters
    errors: ExpectedErrors
    trusted: NDArray[np.float32]
    logit: Tensor | None
    classes: Classes

    @property
    def metal(self) -> NDArray[np.float32] | None:
        """(H, W) share of each texel that is metal; None where none is."""
        if not any(self.classes.metal):
            return None
        return np.asarray(self.classes.metal_share[0].numpy(), np.float32)

    @property
    def confidence(self) -> dict[str, NDArray[np.float32]]:
        """(H, W) each, by map."""
        return dict(zip(CHANNELS, self.trusted, strict=True))


@torch.no_grad()
def find_piece(
    plane: Plane,
    coarse: CoarseFit,
    network: Inverse,
    waves: tuple[Wave, ...] = (),
    *,
    fine: Plane | None = None,
    absolute: bool = False,
    target: Callable[[], PhotographTarget] | None = None,
    steps: int = 0,
    seconds: Callable[[], float] | None = None,
    seed: int = 0,
    stage: Stage = lambda name: nullcontext(),
    on_progress: Callable[[float], None] | None = None,
) -> ExemplarEstimate:
    """Maps of the photographed piece, stage by stage.

    An interrupt while it is refined or adapted ends with the best so far; one before that goes on.

    Args:
        plane: the photograph, on the texels it is read on.
        coarse: its coarse fit.
        network: reads it (network/store.py).
        waves: the plane waves of its regular order.
        fine: the same photograph on more texels, as many as the piece is to have (detail.py);
            None for as many as it is read on.
        absolute: the flash's strength is known, and albedo with it.
        target: gives the photograph's statistics; without them the piece is not adapted.
        steps: of adaptation.
        seconds: of adaptation at most from now on, asked when each leg of it begins.
        seed: of adaptation.
        stage: entered with the name of each stage.
        on_progress: called as the texture-statistics fit goes on with the share that is done.
    """
    with stage("piece"):
        sight = Sight.of(plane, coarse)
        sight, reading = read_piece(sight, network)
    with stage("strengths"):
        strengths = measured_relief(sight, reading)
        sight, reading = classified(sight, strengthened(sight, reading, strengths))
    explained = _Explained(reading)
    with explained.until_interrupted():
        with stage("refine"):
            explained.reading = levelled(sight, reading)
        if target is not None and steps:
            with stage("adapt"):
                doubt = strengths.doubts() if strengths else ()
                wanted = target()
                for each in legs(steps, seconds, seed, doubt, on_progress):
                    explained.adapt(sight, wanted, each)
    whole = plane if fine is None else fine
    with stage("inpaint"):
        tried = INPAINT.tried if steps and not explained.interrupted else INPAINT.tried_at_once
        exemplar = _in_detail(sight, inpainted(sight, explained.reading, tried), whole)
        scale = 1.0 if absolute else most_probable_scale(exemplar, explained.reading.metal)
    with stage("index"):
        example = indexed(scaled(exemplar, scale), waves, whole.size[0] / plane.size[0])
    return replace(_estimate(sight, whole, explained, strengths, example), scale=scale)


def indexed(exemplar: Exemplar, waves: Sequence[Wave], longer: float = 1.0) -> Example:
    """An exemplar ready to be rearranged, as varied as keeps what is long in it.

    Args:
        exemplar: the piece.
        waves: of its regular order.
        longer: its texels across over those that the waves' unit is.
    """
    return chosen(Example.of(exemplar, tuple((w.fx / longer, w.fy / longer) for w in waves)))


@dataclass
class _Explained:
    """What was reached when re-rendering and adaptation end, or are interrupted."""

    reading: Reading
    changes: list[Change] = field(default_factory=list)
    interrupted: bool = False

    @contextmanager
    def until_interrupted(self) -> Iterator[None]:
        """What is done in the block, up to an interrupt."""
        try:
            yield
        except KeyboardInterrupt:
            self.interrupted = True

    def adapt(self, sight: Sight, target: PhotographTarget, leg: Leg) -> None:
        """One leg more; interrupts with what it reached."""
        self.reading, result = adapted(sight, self.reading, target, leg)
        self.changes += [result.change] if result.change else []
        if result.interrupted:
            raise KeyboardInterrupt


def _estimate(
    sight: Sight,
    fine: Plane,
    explained: _Explained,
    strengths: Strengths | None,
    example: Example,
) -> ExemplarEstimate:
    """The piece, and what its re-rendering leaves of the photograph."""
    departures, plane = explained.reading.departures, sight.plane
    left = remaining(departures, plane.linear, plane.measured, sight.light)
    return ExemplarEstimate(
        example=example,
        strengths=strengths,
        error=_median(left, sight),
        slow=float(left.slow.abs().mean()),
        sharpness=sharpness(piece_maps(example.exemplar), fine, sight.coarse),
        adaptation=tuple(explained.changes),
        interrupted=explained.interrupted,
    )


def unexplained(sight: Sight, reading: Reading) -> float:
    """Median difference of log radiance between photograph and re-rendering, where it was seen."""
    plane = sight.plane
    return _median(remaining(reading.departures, plane.linear, plane.measured, sight.light), sight)


def _median(left: Refined, sight: Sight) -> float:
    seen = left.residual[:, sight.plane.valid]
    return float(seen.abs().median()) if seen.numel() else 0.0


def read_piece(sight: Sight, network: Inverse) -> tuple[Sight, Reading]:
    """What the network reads; and the sight of it, which has metal's colour."""
    answer = NetworkAnswer.from_stacked(_read(network, sight.inputs.stacked()))
    trusted = confidence(answer.errors, sight.seen)
    trusted[0] *= 1.0 - sight.glare
    some = metal_share(answer.metal)
    classes = Classes.whole(sight.glare.shape, metal=sight.coarse.conductor)
    if sight.coarse.conductor:
        sight = tinted(sight, classes.metal_share)
    logit = None if some is None else answer.metal
    return sight, Reading(answer.departures, answer.errors, trusted, logit, classes)


def tinted(sight: Sight, metal: Tensor) -> Sight:
    """The sight of a piece of which shares (1, H, W) are metal of the colour that is seen there."""
    seen = seen_colour(sight.plane.linear, metal * sight.shown.all(0, keepdim=True))
    return replace(sight, light=replace(sight.light, hue=tint(metal, seen)))


def measured_relief(sight: Sight, reading: Reading) -> Strengths | None:
    """Relief and albedo energies measured by the photograph; None where too little can be used."""
    shown = sight.light.slope_sensitivity(sight.light.maps(reading.departures))
    return plane_strengths(sight.plane, sight.inputs, shown)


def strengthened(sight: Sight, reading: Reading, strengths: Strengths | None) -> Reading:
    """Relief as strong as the photograph says, everywhere and in all directions."""
    drawn, sensitivity = reading.departures, sight.inputs.slope_sensitivity.numpy()
    height = torch.from_numpy(equalise(drawn.height[0].numpy(), strengths, sensitivity))[None]
    return replace(reading, departures=replace(drawn, height=height))


def classified(sight: Sight, reading: Reading) -> tuple[Sight, Reading]:
    """Texels in material classes; what is their own is albedo (a metal's: F0) and relief."""
    classes = reading.classes
    if reading.logit is not None:
        target = replace(
            _ring_target(sight, reading.departures, Classes.whole(sight.glare.shape, metal=False)),
            surface=sight.light.uniform,
        )
        mixture = find_mixture(reading.departures, reading.logit, target)
        if mixture.likely(sight.light.uniform):
            classes = mixture.classes
            sight = tinted(sight, classes.metal_share)
    settled = classes.settled(reading.departures)
    return sight, replace(reading, departures=settled, classes=classes)


def _ring_target(sight: Sight, departures: SurfaceParameters, classes: Classes) -> RingTarget:
    """The photograph around its mirror point, of a surface that departs so from the coarse fit."""
    plane = sight.plane
    width, height = plane.size
    x, y = highlight_foot(sight.coarse.setup)
    points = plane_points(0, 0, width, height, (width, height), dtype=torch.float32)
    points = plane.extent.placed(points)
    hue = 1.0 if sight.light.hue is None else sight.light.hue
    return RingTarget(
        linear=plane.linear,
        measured=sight.shown,
        counts=sight.within,
        distance=torch.hypot(points[0] - x, points[1] - y),
        flash=sight.light.flash,
        normal=sight.light.maps(departures).normal,
        surface=sight.light.uniform + departures,
        hues=tuple(hue if metal else 1.0 for metal in classes.metal),
    )


def with_levels(sight: Sight, reading: Reading, departures: SurfaceParameters) -> Reading:
    """The reading with levels of its classes fitted to how the highlight falls off."""
    classes = reading.classes
    target = _ring_target(sight, departures, classes)
    size = target.distance.shape
    target = target.thinned(LEVEL_TEXELS)
    step = max(1, min(size) // LEVEL_TEXELS)
    shares = classes.shares[:, ::step, ::step]
    deviation = torch.tensor([_METAL_LEVELS if metal else _PLAIN_LEVELS for metal in classes.metal])
    start = torch.zeros_like(classes.levels)
    moved, _ = fit_levels(target, shares, start, LevelPrior(start, deviation))
    classes = replace(classes, levels=classes.levels + moved)
    changed = departures + reading.classes.flat(moved)
    return replace(reading, departures=changed, classes=classes)


LEVEL_TEXELS = 384
# Deviations of levels (log albedo 3, log F0, logit roughness) from what is known before relief is.
_PLAIN_LEVELS = [1.0, 1.0, 1.0, 0.15, 0.3]
_METAL_LEVELS = [0.05, 0.05, 0.05, 0.5, 0.3]


def levelled(sight: Sight, reading: Reading) -> Reading:
    """Levels of the classes, then albedo of every texel, as the photograph has them."""
    flat = evened(sight, reading, reading.departures)
    reading = with_levels(sight, reading, flat)
    plane = sight.plane
    steep = scaled_by_glints(
        reading.departures, plane.linear, plane.measured, sight.light, sight.noise
    )
    reading = with_levels(sight, reading, steep)
    return _rerendered(sight, reading, reading.departures)


@dataclass(frozen=True)
class Leg:
    """A leg of adaptation; the attributes are arguments of adapt."""

    steps: int
    reach: float
    doubt: Sequence[float]
    seconds: float | None
    seed: int
    on_progress: Callable[[float], None] | None


def legs(
    steps: int,
    seconds: Callable[[], float] | None,
    seed: int,
    doubt: Sequence[float],
    on_progress: Callable[[float], None] | None,
) -> Iterator[Leg]:
    """The legs of so many steps in all, and of as many seconds as there still are."""
    count = len(ADAPT.legs)
    for number, reach in enumerate(ADAPT.legs):
        yield Leg(
            -(-steps // count),
            reach,
            doubt,
            None if seconds is None else ADAPT.stepping * seconds() / (count - number),
            seed * count + number,
            on_progress and _shared(on_progress, number),
        )


def adapted(
    sight: Sight, reading: Reading, target: PhotographTarget, leg: Leg
) -> tuple[Reading, Adapted]:
    """A leg of adaptation, if it earns its place, and what it came to.

    Statistics may come nearer while the piece itself no longer looks like the photograph: bare iron
    beside rust, predicted as paint, gains a likeness from rings. Such a leg is not taken.
    """
    plane = sight.plane
    departures = reading.departures
    weight = np.square(reading.confidence["diffuse"])
    albedo = torch.from_numpy(even_contrast(departures.diffuse.numpy(), weight))
    fitted = adapt(
        sight.light.maps(replace(departures, diffuse=albedo), plane.texel_size),
        plane.valid.numpy(),
        target,
        leg.steps,
        reach=leg.reach,
        doubt=leg.doubt,
        seconds=leg.seconds,
        seed=leg.seed,
        on_progress=leg.on_progress,
    )
    if fitted.change is None or not fitted.change.kept:
        return reading, fitted
    tried = _rerendered(sight, reading, sight.light.departures(fitted.maps))
    before = max(unexplained(sight, reading), ADAPT.unexplained)
    if unexplained(sight, tried) > ADAPT.more_unexplained * before:
        return reading, replace(fitted, change=replace(fitted.change, kept=False))
    return tried, fitted


def exemplar_of(sight: Sight, reading: Reading) -> Exemplar:
    """The maps as they are, and how far they are trusted."""
    maps = sight.light.maps(reading.departures, sight.plane.texel_size)
    return Exemplar(
        diffuse=maps.diffuse.numpy(),
        specular=maps.specular.numpy(),
        roughness=maps.roughness.numpy(),
        height=maps.height.numpy(),
        confidence=reading.trusted,
        texel_size=sight.plane.texel_size,
    )


def inpainted(sight: Sight, reading: Reading, tried: int) -> Exemplar:
    """The exemplar, inpainted where specular light hides albedo; `tried` blocks for a place."""
    plane = sight.plane
    exemplar = exemplar_of(sight, reading)
    left_out = None if plane.left_out is None else plane.left_out.numpy()
    return transport(
        exemplar,
        plane.linear,
        plane.valid,
        sight.light,
        tried=tried,
        left_out=left_out,
    )


def _in_detail(sight: Sight, exemplar: Exemplar, whole: Plane) -> Exemplar:
    """The exemplar on as many texels as the photograph is to have."""
    return exemplar if whole.size == sight.plane.size else finest(exemplar, whole, sight.coarse)


def evened(sight: Sight, reading: Reading, departures: SurfaceParameters) -> SurfaceParameters:
    """Departures whose albedo does not drift over the exemplar, beyond what its classes do."""
    across = sight.plane.extent.unit(sight.plane.size[0]) if sight.plane.margins.any else None
    levels = reading.classes.flat()
    trusted = reading.confidence["diffuse"]
    return flatten(departures - levels, trusted, sight.glare, across=across) + levels


def _rerendered(sight: Sight, reading: Reading, departures: SurfaceParameters) -> Reading:
    """Albedo moved until it re-renders to the photograph."""
    metal = reading.classes.metal_share if any(reading.classes.metal) else None
    refined = refine(
        departures,
        reading.errors,
        sight.plane.linear,
        sight.shown,
        sight.light,
        metal=metal,
        noise=sight.noise,
    )
    return replace(reading, departures=evened(sight, reading, refined.departures))


def _shared(on_progress: Callable[[float], None], leg: int) -> Callable[[float], None]:
    """Progress of one leg as a share of all."""
    return lambda share: on_progress((leg + share) / len(ADAPT.legs))


def piece_maps(exemplar: Exemplar) -> MapSet:
    """The photographed piece as a map set."""
    stacked = torch.from_numpy(exemplar.stacked())
    return MapSet.from_stacked(stacked, exemplar.texel_size)


def confidence(
    errors: ExpectedErrors, seen: NDArray[np.float32], unit: float | None = None
) -> NDArray[np.float32]:
    """(4, H, W) in [0, 1] of expected errors and of what was seen (H, W).

    Of neighbourhoods: confidence is about where the light shows a map, not about which of the
    material's features are easily read, or only its plain places would be trusted.

    Args:
        errors, seen: see there.
        unit: texels of the photograph's long side, where the piece reaches beyond it.
    """
    doubt = errors.stacked().clamp(-8.0, 4.0).exp().numpy()
    units = (
        READ.doubted_albedo, READ.doubted_specular, READ.doubted_roughness, READ.doubted_slope,
    )  # fmt: skip
    doubt = doubt / np.array(units, np.float32)[:, None, None]
    around = (unit or max(seen.shape)) / READ.confidence_around
    certain = np.stack([np.exp(-smoothed(plane, around)) for plane in doubt])
    return np.ascontiguousarray(certain * seen, dtype=np.float32)


def seen_share(measured: Tensor) -> NDArray[np.float32]:
    """(H, W) in [0, 1]: how far a texel and what is beside it were seen, of channels (3, H, W).

    A clipped texel's neighbours hold some of its light; a sparkle costs them little, while a spot
    that is burnt out, wide as it is, is not seen at all.
    """
    share = measured.float().mean(0).numpy()
    around = cv2.GaussianBlur(share, (0, 0), READ.spread_of_light, borderType=cv2.BORDER_REFLECT)
    return np.asarray(np.minimum(share, np.clip(2.0 * around - 1.0, 0.0, 1.0)), np.float32)


def lit(linear: Tensor) -> Tensor:
    """(H, W) bool: where the neighbourhood's radiance (3, H, W) is above the noise."""
    return torch.from_numpy(smoothed(linear.mean(0).numpy(), READ.unlit_around) > READ.unlit)


def _read(network: Inverse, inputs: Tensor) -> Tensor:
    """(ANSWERS, H, W) of a picture of any size.

    The network works on squares of 2 x 2 texels, and texels of a square differ by its place in
    them: a mesh, seen under a low light. So the picture is read with its squares begun at each of
    their four texels, and what is read is the mean.
    """
    height, width = inputs.shape[-2:]
    multiple = network.config.multiple
    total: Tensor | None = None
    for down, across in ((0, 0), (0, 1), (1, 0), (1, 1)):
        pad = (across, -(width + across) % multiple, down, -(height + down) % multiple)
        mode = "reflect" if max(pad) < min(height, width) else "replicate"
        whole = F.pad(inputs[None], pad, mode=mode) if any(pad) else inputs[None]
        answer: Tensor = network(whole.contiguous(memory_format=torch.channels_last))
        answer = answer[0, :, down : down + height, across : across + width]
        total = answer if total is None else total + answer
    assert total is not None
    return total / 4.0
