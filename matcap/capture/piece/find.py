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
from matcap.example.variety import with_chosen_variety
from matcap.flash.coarse import CoarseFit
from matcap.flash.geometry import flash_mirror_point, plane_points
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
class Observation:
    """A photograph of a piece, and its light.

    Attributes:
        plane: the photograph; valid where it was seen and lit.
        coarse: its coarse fit.
        shown: (3, H, W) bool: seen and lit, or beyond the photograph, by channel.
        within: (H, W) bool: the material, in the photograph.
        seen: (H, W) share of each place that was seen, in [0, 1].
        inputs: of the network.
        light: the photograph's, at every texel.
        specular_fraction: (H, W) specular fraction of the uniform material's radiance.
        noise: (3, H, W) of log radiance, the sensor's or the codes'.
    """

    plane: Plane
    coarse: CoarseFit
    shown: Tensor
    within: Tensor
    seen: NDArray[np.float32]
    inputs: NetworkInputs
    light: PieceLight
    specular_fraction: NDArray[np.float32]
    noise: Tensor

    @staticmethod
    def of(plane: Plane, coarse: CoarseFit) -> Observation:
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
        specular_fraction = inputs.gloss[0].clamp(0.0, 1.0).numpy()
        light = PieceLight.of(coarse, points)
        seen = seen_share(measured)
        return Observation(
            plane,
            coarse,
            shown,
            ~mirrors,
            seen,
            inputs,
            light,
            specular_fraction,
            channel_noise(plane),
        )


@dataclass(frozen=True)
class NetworkPrediction:
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
        observed = Observation.of(plane, coarse)
        observed, prediction = read_piece(observed, network)
    with stage("strengths"):
        strengths = measured_relief(observed, prediction)
        observed, prediction = classified(observed, strengthened(observed, prediction, strengths))
    explained = _Explained(prediction)
    with explained.until_interrupted():
        with stage("refine"):
            explained.prediction = levelled(observed, prediction)
        if target is not None and steps:
            with stage("adapt"):
                doubt = strengths.doubts() if strengths else ()
                wanted = target()
                for each in legs(steps, seconds, seed, doubt, on_progress):
                    explained.adapt(observed, wanted, each)
    whole = plane if fine is None else fine
    with stage("inpaint"):
        tried = INPAINT.tried if steps and not explained.interrupted else INPAINT.tried_at_once
        exemplar = _in_detail(observed, inpainted(observed, explained.prediction, tried), whole)
        scale = 1.0 if absolute else most_probable_scale(exemplar, explained.prediction.metal)
    with stage("index"):
        example = indexed(scaled(exemplar, scale), waves, whole.size[0] / plane.size[0])
    return replace(_estimate(observed, whole, explained, strengths, example), scale=scale)


def indexed(exemplar: Exemplar, waves: Sequence[Wave], longer: float = 1.0) -> Example:
    """An exemplar ready to be rearranged, as varied as keeps what is long in it.

    Args:
        exemplar: the piece.
        waves: of its regular order.
        longer: its texels across over those that the waves' unit is.
    """
    return with_chosen_variety(
        Example.of(exemplar, tuple((w.fx / longer, w.fy / longer) for w in waves))
    )


@dataclass
class _Explained:
    """What was reached when re-rendering and adaptation end, or are interrupted."""

    prediction: NetworkPrediction
    changes: list[Change] = field(default_factory=list)
    interrupted: bool = False

    @contextmanager
    def until_interrupted(self) -> Iterator[None]:
        """What is done in the block, up to an interrupt."""
        try:
            yield
        except KeyboardInterrupt:
            self.interrupted = True

    def adapt(self, observed: Observation, target: PhotographTarget, leg: Leg) -> None:
        """One leg more; interrupts with what it reached."""
        self.prediction, result = adapted(observed, self.prediction, target, leg)
        self.changes += [result.change] if result.change else []
        if result.interrupted:
            raise KeyboardInterrupt


def _estimate(
    observed: Observation,
    fine: Plane,
    explained: _Explained,
    strengths: Strengths | None,
    example: Example,
) -> ExemplarEstimate:
    """The piece, and what its re-rendering leaves of the photograph."""
    departures, plane = explained.prediction.departures, observed.plane
    left = remaining(departures, plane.linear, plane.measured, observed.light)
    return ExemplarEstimate(
        example=example,
        strengths=strengths,
        error=_median(left, observed),
        slow=float(left.slow.abs().mean()),
        sharpness=sharpness(piece_maps(example.exemplar), fine, observed.coarse),
        adaptation=tuple(explained.changes),
        interrupted=explained.interrupted,
    )


def unexplained(observed: Observation, prediction: NetworkPrediction) -> float:
    """Median difference of log radiance between photograph and re-rendering, where it was seen."""
    plane = observed.plane
    return _median(
        remaining(prediction.departures, plane.linear, plane.measured, observed.light), observed
    )


def _median(left: Refined, observed: Observation) -> float:
    seen = left.residual[:, observed.plane.valid]
    return float(seen.abs().median()) if seen.numel() else 0.0


def read_piece(observed: Observation, network: Inverse) -> tuple[Observation, NetworkPrediction]:
    """Predict the maps; the observation's light gets the specular tint of metal."""
    answer = NetworkAnswer.from_stacked(_read(network, observed.inputs.stacked()))
    trusted = confidence(answer.errors, observed.seen)
    trusted[0] *= 1.0 - observed.specular_fraction
    some = metal_share(answer.metal)
    classes = Classes.whole(observed.specular_fraction.shape, metal=observed.coarse.conductor)
    if observed.coarse.conductor:
        observed = tinted(observed, classes.metal_share)
    logit = None if some is None else answer.metal
    return observed, NetworkPrediction(answer.departures, answer.errors, trusted, logit, classes)


def tinted(observed: Observation, metal: Tensor) -> Observation:
    """The observation with the specular tint seen where shares (1, H, W) are metal."""
    seen = seen_colour(observed.plane.linear, metal * observed.shown.all(0, keepdim=True))
    return replace(observed, light=replace(observed.light, hue=tint(metal, seen)))


def measured_relief(observed: Observation, prediction: NetworkPrediction) -> Strengths | None:
    """Relief and albedo energies measured by the photograph; None where too little can be used."""
    shown = observed.light.slope_sensitivity(observed.light.maps(prediction.departures))
    return plane_strengths(observed.plane, observed.inputs, shown)


def strengthened(
    observed: Observation, prediction: NetworkPrediction, strengths: Strengths | None
) -> NetworkPrediction:
    """Relief as strong as the photograph says, everywhere and in all directions."""
    drawn, sensitivity = prediction.departures, observed.inputs.slope_sensitivity.numpy()
    height = torch.from_numpy(equalise(drawn.height[0].numpy(), strengths, sensitivity))[None]
    return replace(prediction, departures=replace(drawn, height=height))


def classified(
    observed: Observation, prediction: NetworkPrediction
) -> tuple[Observation, NetworkPrediction]:
    """Texels in material classes; what is their own is albedo (a metal's: F0) and relief."""
    classes = prediction.classes
    if prediction.logit is not None:
        target = replace(
            _ring_target(
                observed,
                prediction.departures,
                Classes.whole(observed.specular_fraction.shape, metal=False),
            ),
            surface=observed.light.uniform,
        )
        mixture = find_mixture(prediction.departures, prediction.logit, target)
        if mixture.likely(observed.light.uniform):
            classes = mixture.classes
            observed = tinted(observed, classes.metal_share)
    settled = classes.settled(prediction.departures)
    return observed, replace(prediction, departures=settled, classes=classes)


def _ring_target(
    observed: Observation, departures: SurfaceParameters, classes: Classes
) -> RingTarget:
    """The photograph around its mirror point, of a surface that departs so from the coarse fit."""
    plane = observed.plane
    width, height = plane.size
    x, y = flash_mirror_point(observed.coarse.setup)
    points = plane_points(0, 0, width, height, (width, height), dtype=torch.float32)
    points = plane.extent.placed(points)
    hue = 1.0 if observed.light.hue is None else observed.light.hue
    return RingTarget(
        linear=plane.linear,
        measured=observed.shown,
        counts=observed.within,
        distance=torch.hypot(points[0] - x, points[1] - y),
        flash=observed.light.flash,
        normal=observed.light.maps(departures).normal,
        surface=observed.light.uniform + departures,
        hues=tuple(hue if metal else 1.0 for metal in classes.metal),
    )


def with_levels(
    observed: Observation, prediction: NetworkPrediction, departures: SurfaceParameters
) -> NetworkPrediction:
    """The prediction with levels of its classes fitted to how the highlight falls off."""
    classes = prediction.classes
    target = _ring_target(observed, departures, classes)
    size = target.distance.shape
    target = target.thinned(LEVEL_TEXELS)
    step = max(1, min(size) // LEVEL_TEXELS)
    shares = classes.shares[:, ::step, ::step]
    deviation = torch.tensor([_METAL_LEVELS if metal else _PLAIN_LEVELS for metal in classes.metal])
    start = torch.zeros_like(classes.levels)
    moved, _ = fit_levels(target, shares, start, LevelPrior(start, deviation))
    classes = replace(classes, levels=classes.levels + moved)
    changed = departures + prediction.classes.flat(moved)
    return replace(prediction, departures=changed, classes=classes)


LEVEL_TEXELS = 384
# Deviations of levels (log albedo 3, log F0, logit roughness) from what is known before relief is.
_PLAIN_LEVELS = [1.0, 1.0, 1.0, 0.15, 0.3]
_METAL_LEVELS = [0.05, 0.05, 0.05, 0.5, 0.3]


def levelled(observed: Observation, prediction: NetworkPrediction) -> NetworkPrediction:
    """Levels of the classes, then albedo of every texel, as the photograph has them."""
    flat = evened(observed, prediction, prediction.departures)
    prediction = with_levels(observed, prediction, flat)
    plane = observed.plane
    steep = scaled_by_glints(
        prediction.departures, plane.linear, plane.measured, observed.light, observed.noise
    )
    prediction = with_levels(observed, prediction, steep)
    return _rerendered(observed, prediction, prediction.departures)


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
    observed: Observation, prediction: NetworkPrediction, target: PhotographTarget, leg: Leg
) -> tuple[NetworkPrediction, Adapted]:
    """A leg of adaptation, if it earns its place, and what it came to.

    Statistics may come nearer while the piece itself no longer looks like the photograph: bare iron
    beside rust, predicted as paint, gains a likeness from rings. Such a leg is not taken.
    """
    plane = observed.plane
    departures = prediction.departures
    weight = np.square(prediction.confidence["diffuse"])
    albedo = torch.from_numpy(even_contrast(departures.diffuse.numpy(), weight))
    fitted = adapt(
        observed.light.maps(replace(departures, diffuse=albedo), plane.texel_size),
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
        return prediction, fitted
    tried = _rerendered(observed, prediction, observed.light.departures(fitted.maps))
    before = max(unexplained(observed, prediction), ADAPT.unexplained)
    if unexplained(observed, tried) > ADAPT.more_unexplained * before:
        return prediction, replace(fitted, change=replace(fitted.change, kept=False))
    return tried, fitted


def exemplar_of(observed: Observation, prediction: NetworkPrediction) -> Exemplar:
    """The maps as they are, and how far they are trusted."""
    maps = observed.light.maps(prediction.departures, observed.plane.texel_size)
    return Exemplar(
        diffuse=maps.diffuse.numpy(),
        specular=maps.specular.numpy(),
        roughness=maps.roughness.numpy(),
        height=maps.height.numpy(),
        confidence=prediction.trusted,
        texel_size=observed.plane.texel_size,
    )


def inpainted(observed: Observation, prediction: NetworkPrediction, tried: int) -> Exemplar:
    """The exemplar, inpainted where specular light hides albedo; `tried` blocks for a place."""
    plane = observed.plane
    exemplar = exemplar_of(observed, prediction)
    left_out = None if plane.left_out is None else plane.left_out.numpy()
    return transport(
        exemplar,
        plane.linear,
        plane.valid,
        observed.light,
        tried=tried,
        left_out=left_out,
    )


def _in_detail(observed: Observation, exemplar: Exemplar, whole: Plane) -> Exemplar:
    """The exemplar on as many texels as the photograph is to have."""
    return (
        exemplar if whole.size == observed.plane.size else finest(exemplar, whole, observed.coarse)
    )


def evened(
    observed: Observation, prediction: NetworkPrediction, departures: SurfaceParameters
) -> SurfaceParameters:
    """Departures whose albedo does not drift over the exemplar, beyond what its classes do."""
    across = (
        observed.plane.extent.unit(observed.plane.size[0]) if observed.plane.margins.any else None
    )
    levels = prediction.classes.flat()
    trusted = prediction.confidence["diffuse"]
    return flatten(departures - levels, trusted, observed.specular_fraction, across=across) + levels


def _rerendered(
    observed: Observation, prediction: NetworkPrediction, departures: SurfaceParameters
) -> NetworkPrediction:
    """Albedo moved until it re-renders to the photograph."""
    metal = prediction.classes.metal_share if any(prediction.classes.metal) else None
    refined = refine(
        departures,
        prediction.errors,
        observed.plane.linear,
        observed.shown,
        observed.light,
        metal=metal,
        noise=observed.noise,
    )
    return replace(prediction, departures=evened(observed, prediction, refined.departures))


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
