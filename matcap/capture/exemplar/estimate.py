"""The stages that estimate the exemplar of a photograph, in order.

In comes a photograph on its plane (Rectified), out goes an ExemplarEstimate. The network predicts
maps (predict.py); relief is scaled to the energies that the photograph measures
(relief_spectrum.py), and texels are classified (predict.py); mean parameters and albedo
are refined until the maps re-render to the photograph (refine.py); hidden maps are inpainted
(inpaint.py), fine detail and the exposure are added (detail_transfer.py, mean_parameters.py); the
result is indexed for synthesis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from matcap.brdf.cook_torrance import ROUGHNESS_LIMITS
from matcap.brdf.maps import CHANNELS
from matcap.capture.exemplar.detail_transfer import transfer_detail
from matcap.capture.exemplar.glints import without_glints
from matcap.capture.exemplar.inpaint import inpainted
from matcap.capture.exemplar.lattice_relief import averaged_over_cells
from matcap.capture.exemplar.mean_parameters import (
    DIELECTRIC,
    RingTarget,
    most_probable_scale,
    scaled,
)
from matcap.capture.exemplar.network.network import Inverse
from matcap.capture.exemplar.octaves import filled, local_mean, smoothed
from matcap.capture.exemplar.predict import (
    NetworkPrediction,
    exemplar_of,
    find_mixture,
    grey_noise,
    predict_maps,
    tinted,
)
from matcap.capture.exemplar.refine import radiance_residual, refine_maps, refitted_to_highlight
from matcap.capture.exemplar.relief_spectrum import (
    RESPONSE_AROUND,
    ReliefSpectrum,
    equalise,
    measure_relief_spectrum,
)
from matcap.capture.rectified import Observation, Rectified, channel_weights
from matcap.capture.settings import CaptureClock
from matcap.example.candidates import Frame
from matcap.example.example import Example
from matcap.example.exemplar import Exemplar, halves
from matcap.example.fine_lattice import straightened
from matcap.example.placement import evenly_sharp
from matcap.example.variety import with_chosen_variety, with_least_steps
from matcap.files.threads import at_once
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.rectify import Plane
from matcap.photo.left_out import largest_rectangle
from matcap.statistics.lattice import Wave

if TYPE_CHECKING:
    from matcap.capture.multiview.set_report import SetReport

TexelMask = NDArray[np.bool_]
Floats = NDArray[np.float32]

_MOST_KEPT = 0.7  # least share of the photographed texels in the rectangle that fields show
# Texels: largest deviation of the blur along grooves, and that of local means of relief.
_LONGEST_LINE, _OF_RELIEF = 24.0, 32.0


@dataclass(frozen=True)
class ExemplarEstimate:
    """The estimate of an exemplar: its maps, and how well they explain the photograph."""

    exemplar: Exemplar
    """The estimated maps with their confidence."""
    example: Example
    """These maps, a fine lattice straightened, indexed for synthesis."""
    relief_spectrum: ReliefSpectrum | None
    """Relief and albedo energies measured in the photograph, or None."""
    error: float
    """Median |log radiance of photograph - re-rendering| of valid texels."""
    several: SetReport | None = None
    """Report on several photographs; None for one."""
    scale: float = 1.0
    """Factor on albedo and F0 by mean_parameters.py; the flash is divided by it."""
    level_deviation: float | None = None
    """Standard deviation of the log of a dielectric's mean albedo, by that of albedo over F0
    (CoarseFit) and the prior of F0; None if any texel is metal, and if the level is given."""
    turned: bool = False
    """Whether the maps are rotated to a portrait photograph's orientation."""
    kept: TexelMask | None = None
    """(H, W) texels of the material that one photograph shows; None if all, or for several."""

    @property
    def level(self) -> float:
        """Mean albedo."""
        return float(self.exemplar.diffuse.mean())

    @property
    def first_rectangle(self) -> Exemplar:
        """The maps within the first photograph's rectangle."""
        several = self.several
        if several is None or not several.mosaic.margins.any:
            return self.exemplar
        margins, size = several.mosaic.margins, several.mosaic.size
        if self.turned:
            margins, size = margins.turned(), size[::-1]
        return self.exemplar.cut(*margins.inside(size))

    def upright(self, waves: tuple[Wave, ...]) -> ExemplarEstimate:
        """A portrait's estimate, its maps rotated upright; `waves` is their lattice."""
        exemplar, example = indexed(self.exemplar, waves, turned=True, kept=self.kept)
        kept = _upright(self.kept, turned=True)
        return replace(self, exemplar=exemplar, example=example, turned=True, kept=kept)

    def mean_confidence(self, kept: float = 1.0) -> dict[str, float]:
        """Mean confidence by map, in [0, 1], over the share `kept` of the photograph's texels."""
        if self.several is not None and self.several.mosaic.margins.any:
            kept = self.several.mosaic.known
        means = np.minimum(self.exemplar.confidence.mean((1, 2)) / np.float32(kept), 1.0).tolist()
        return dict(zip(CHANNELS, means, strict=True))


@dataclass(frozen=True)
class KnownMeans:
    """Means of an exemplar's maps that the photograph leaves open and the user gives."""

    albedo: float | None = None
    """Mean diffuse albedo; of metal, mean F0."""
    roughness: float | None = None
    """Mean roughness."""
    absolute: bool = False
    """Whether the flash intensity is known, and with it the albedo."""

    def scale(self, exemplar: Exemplar, metal: NDArray[np.float32]) -> float:
        """Factor on albedo and F0: what makes the mean the given one, or the most probable."""
        if self.albedo is None:
            return 1.0 if self.absolute else most_probable_scale(exemplar, metal)
        seen = exemplar.specular if metal.mean() > 0.5 else exemplar.diffuse
        return self.albedo / max(float(seen.mean()), 1e-4)

    def rougher(self, exemplar: Exemplar) -> Exemplar:
        """The exemplar with its roughness scaled to the given mean."""
        if self.roughness is None:
            return exemplar
        factor = self.roughness / float(exemplar.roughness.mean())
        return replace(exemplar, roughness=np.clip(exemplar.roughness * factor, *ROUGHNESS_LIMITS))


@torch.no_grad()
def estimate_exemplar(
    rectified: Rectified,
    network: Inverse,
    clock: CaptureClock,
    known: KnownMeans | None = None,
    *,
    turned: bool = False,
) -> ExemplarEstimate:
    """Estimate the exemplar of a photograph, stage by stage.

    Args:
        rectified: the photograph on its plane.
        known: what is known of its means, so that no prior is used.
        turned: whether the photograph is a portrait.
    """
    whole, plane, known = rectified.whole, rectified.network_input, known or KnownMeans()
    bound = not known.absolute
    observed, prediction, spectrum = refined(
        plane,
        rectified.coarse,
        network,
        clock,
        bound=bound,
        waves=rectified.input_waves,
        finest=plane.size == whole.size,
    )
    coarse = observed.coarse
    stated = known.absolute or known.albedo is not None or prediction.metal.any()
    over_f0 = None if stated else coarse.level_deviation
    with clock.stage("inpaint"):
        measured = exemplar_of(observed, prediction)
        exemplar, copies = inpainted(measured, observed, rectified.input_waves)
        if copies is not None and spectrum is not None and spectrum.across is not None:
            heights, seen = (exemplar.height[0], measured.height[0]), observed.plane.valid.numpy()
            height = continued_grooves(*heights, seen, copies.copied, spectrum.across)
            exemplar = replace(exemplar, height=height[None])
        exemplar = refitted_to_highlight(exemplar, observed, prediction.metal)
        matte = without_glints(whole, coarse, metal=bool(prediction.metal.any()))
        exemplar = transfer_detail(exemplar, matte, coarse, copies)
        scale = known.scale(exemplar, prediction.metal)
        exemplar = known.rougher(scaled(exemplar, scale)).rounded()
        plane = observed.plane
        photograph = plane.linear, plane.measured, observed.light
        off = radiance_residual(prediction.residuals, *photograph)[:, plane.valid]
        error = float(off.abs().median()) if off.numel() else 0.0
    del observed, prediction, plane, photograph, matte, off  # 200 MB of 1024 texels across
    with clock.stage("index"):
        kept = None if whole.left_out is None else whole.kept.numpy()
        exemplar, example = indexed(exemplar, rectified.waves, turned=turned, kept=kept)
    return ExemplarEstimate(
        exemplar,
        example,
        spectrum,
        error,
        scale=scale * coarse.specular / rectified.coarse.specular,
        level_deviation=over_f0 and math.hypot(over_f0, DIELECTRIC.specular.deviation),
        turned=turned,
        kept=_upright(kept, turned=turned),
    )


def continued_grooves(
    height: Floats,
    measured: Floats,
    seen: TexelMask,
    copied: TexelMask,
    across: float,
) -> Floats:
    """Height (H, W) with the grooves of copied texels joined to those around them.

    Copied blocks cut grooves off. Measured relief is kept up to where the highlight is clipped, and
    the rest is blurred along the grooves, where what is measured counts most, over the length
    rms h / rms dh/du that they have elsewhere along their direction u. Local energy is restored.

    Args:
        height: with copies; any unit.
        measured: before these.
        seen: (H, W) visible and not clipped.
        copied: (H, W).
        across: direction across grooves, radians from x, y upwards.
    """
    around = cv2.GaussianBlur(seen.astype(np.float32), (0, 0), 4.0)
    kept = np.where(copied, np.clip(4.0 * around - 3.0, 0.0, 1.0), 1.0).astype(np.float32)
    whole = height + kept * (measured - height)
    slow = smoothed(whole, _OF_RELIEF)
    fine = whole - slow
    x, down = -math.sin(across), -math.cos(across)  # along the grooves
    slope = x * np.gradient(fine, axis=1) + down * np.gradient(fine, axis=0)
    own = ~copied
    energy = float(np.square(fine)[own].mean()) if own.any() else 0.0
    along = math.sqrt(energy / max(float(np.square(slope)[own].mean()), 1e-24)) if energy else 1.0
    deviation = min(max(along, 1.0), _LONGEST_LINE)
    side = np.arange(-math.ceil(3.0 * deviation), math.ceil(3.0 * deviation) + 1.0)
    u, v = x * side + down * side[:, None], down * side - x * side[:, None]
    line = (np.exp(-0.5 * np.square(u / deviation)) * (1.0 - np.abs(v)).clip(0.0)).astype(
        np.float32
    )
    weight = kept + np.float32(0.05)
    joined = cv2.filter2D(fine * weight, -1, line) / cv2.filter2D(weight, -1, line)
    energies = (
        local_mean(np.square(fine), weight, _OF_RELIEF),
        smoothed(np.square(joined), _OF_RELIEF),
    )
    joined *= np.sqrt(energies[0] / np.maximum(energies[1], np.float32(1e-24))).clip(1.0, 4.0)
    return np.asarray(slow + joined + kept * (fine - joined), np.float32)


def refined(
    plane: Plane,
    coarse: CoarseFit,
    network: Inverse,
    clock: CaptureClock,
    *,
    bound: bool = False,
    waves: tuple[Wave, ...] = (),
    finest: bool = False,
) -> tuple[Observation, NetworkPrediction, ReliefSpectrum | None]:
    """Predict the maps of a plane and fit them to it: stages network, relief spectrum and refine.

    With `bound`, albedo is kept below white (Observation.below_white); `waves` is the lattice of
    one photograph. With `finest`, the maps are not enlarged, which would restore fine slopes.

    Returns:
        The photograph with the specular tint of its metal, the fitted maps, and the energies of
        relief and albedo measured in the photograph.
    """
    with clock.stage("network"):
        observed = Observation.of(plane, coarse)
        bounded = observed.below_white() if bound else observed
        observed, prediction = predict_maps(bounded, network)
    with clock.stage("relief spectrum"):
        spectrum = measured_spectrum(observed)
        prediction = scaled_to_spectrum(observed, prediction, spectrum)
        prediction = with_mean_cell(observed, prediction, waves)
        observed, prediction = classified(observed, prediction)
    with clock.stage("refine"):
        prediction = refine_maps(observed, prediction, spectrum, finest=finest)
    return observed, prediction, spectrum


def indexed(
    exemplar: Exemplar,
    waves: tuple[Wave, ...],
    *,
    turned: bool,
    kept: TexelMask | None = None,
    one_light: bool = True,
) -> tuple[Exemplar, Example]:
    """An exemplar, and its index with the smallest patches that keep its long structures.

    Fields show only a rectangle of what was photographed, unless it has less than _MOST_KEPT of it.

    A fine lattice is straightened in what is indexed, not in what is returned beside it, and has
    large patches: its threads are the same everywhere, and small ones swirl (with_least_steps).
    Of others, sharpness is evened there (evenly_sharp): a soft patch shows near a sharp one. The
    returned exemplar is as photographed.

    Args:
        exemplar: the maps, rounded as in a file.
        waves: frequency vectors of the lattice, cycles per texel.
        turned: whether to rotate both upright first, 90 degrees clockwise.
        kept: (H, W) texels that the photograph shows; None for all.
        one_light: of one photograph: relief is known along one direction at each place, and
            sharpness is that of its lens at each.
    """
    if turned:
        # Rotated by 90 degrees clockwise, frequency (fx, fy) becomes (-fy, fx).
        exemplar, waves = exemplar.turned(), tuple(Wave(-wave.fy, wave.fx) for wave in waves)
    kept = _upright(kept, turned=turned)
    flat = straightened(exemplar, waves)
    if flat is None:
        part = None if kept is None else _shown(kept)

        def evened() -> Exemplar:  # not what is indexed: what departs by a trend keeps its cost
            even = evenly_sharp(exemplar) if one_light else exemplar
            if even is exemplar:
                return exemplar
            return replace(even, diffuse=halves(even.diffuse), specular=halves(even.specular))

        made = partial(Example.of_rounded, exemplar, waves, part=part, one_light=one_light)
        example, even = at_once(made, evened)
        return exemplar, with_chosen_variety(replace(example, exemplar=even))
    return exemplar, with_least_steps(Example.of_rounded(*flat, straight=True))


def _upright(kept: TexelMask | None, *, turned: bool) -> TexelMask | None:
    return np.rot90(kept, -1) if kept is not None and turned else kept


def _shown(kept: TexelMask) -> Frame | None:
    """The largest rectangle of kept texels; None for all if it has too few of them."""
    rows, columns = largest_rectangle(kept)
    if kept[rows, columns].sum() < _MOST_KEPT * kept.sum():
        return None
    return Frame(columns.start, rows.start, columns.stop - 1, rows.stop - 1)


def measured_spectrum(observed: Observation) -> ReliefSpectrum | None:
    """Relief and albedo energies measured in the photograph; None if too few texels are valid.

    The sensitivity to slope is the coarse fit's, which is nearer to the truth than that of the
    predicted maps (docs/notes/capture.md).
    """
    plane, use = observed.plane, observed.plane.measured.numpy()
    noise = grey_noise(observed)[plane.valid.numpy()]
    return measure_relief_spectrum(
        log_residual(observed),
        np.stack([smoothed(s, RESPONSE_AROUND) for s in observed.inputs.slope_sensitivity.numpy()]),
        use.mean(0, dtype=np.float32),
        math.sqrt(float(np.square(noise).mean())) if noise.size else 0.0,
        matte=(1.0 - observed.inputs.gloss[0]).clamp(0.0, 1.0).numpy(),
    )


def log_residual(observed: Observation) -> NDArray[np.float32]:
    """(H, W) log radiance less that of the coarse fit, a weighted mean over channels."""
    # Interpolate clipped texels, to no less than the clipped value.
    channels = zip(observed.inputs.log.numpy(), observed.plane.measured.numpy(), strict=True)
    whole = [np.maximum(filled(channel, seen), channel) for channel, seen in channels]
    return np.asarray((channel_weights(observed.noise).numpy() * whole).sum(0), np.float32)


def with_mean_cell(
    observed: Observation, prediction: NetworkPrediction, waves: tuple[Wave, ...]
) -> NetworkPrediction:
    """Relief of a regular material with its mean cell everywhere (lattice_relief.py)."""
    if not waves:
        return prediction
    predicted = prediction.residuals
    height = averaged_over_cells(predicted.height[0].numpy(), log_residual(observed), waves)
    return replace(prediction, residuals=replace(predicted, height=torch.from_numpy(height)[None]))


def scaled_to_spectrum(
    observed: Observation, prediction: NetworkPrediction, spectrum: ReliefSpectrum | None
) -> NetworkPrediction:
    """Scale relief to the measured energies, equally at all places and directions (equalise)."""
    predicted, sensitivity = prediction.residuals, observed.inputs.slope_sensitivity.numpy()
    planes = (predicted.height[0].numpy(), predicted.diffuse.mean(0).numpy())
    height = torch.from_numpy(equalise(planes[0], spectrum, sensitivity, planes[1]))[None]
    return replace(prediction, residuals=replace(predicted, height=height))


def classified(
    observed: Observation, prediction: NetworkPrediction
) -> tuple[Observation, NetworkPrediction]:
    """Classify texels; a class varies in albedo (of metal: F0) and relief, roughness with it."""
    classes = prediction.classes
    if prediction.logit is not None:
        target = RingTarget.of(observed, prediction.residuals, (False,))
        target = replace(target, surface=observed.light.uniform)
        mixture = find_mixture(prediction.residuals, prediction.logit, target)
        if mixture is not None:
            classes = mixture
            observed = tinted(observed, classes.metal_share)
    gloss = torch.from_numpy(observed.specular_fraction) * observed.plane.valid
    constrained = classes.constrained(prediction.residuals, gloss)
    return observed, replace(prediction, residuals=constrained, classes=classes)
