"""The coarse fit: uniform reflectance, camera and flash from a photograph's low frequencies.

Its accuracy is measured in docs/notes/capture.md.

A flat, uniform material under a flash (cells.py) is fitted to the photograph's means over cells
(cells.py) by robust least squares on log radiance (problem.py). Unknown are albedo or F0,
roughness, flash intensity and offset, tilt, and the falloff of lens and flash.

Two hypotheses are fitted, a dielectric and a conductor (problem.py). The conductor is chosen if
its cost, priors included, is lower by _CONDUCTOR_ODDS nats, and it is neither bluish nor rough,
and most of a developed picture is above its lowest codes, which show no diffuse light.

One photograph leaves ambiguities: flash intensity and albedo, tilt and flash offset, and falloff
and the contrast of a tone curve (photo/photo.py). Weak priors resolve them. The highlight's centre
is a measurement of tilt and offset together (problem.HighlightMeasurements).

The cost has local minima, so the fit starts from several points (starts): from four roughnesses, or
those that the highlight's width implies; and with the highlight's position due to the flash's
offset, or to tilt.

Texture is not modelled. Relief widens the highlight, so the roughness is an upper estimate, which
later stages lower.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from matcap.brdf.cook_torrance import ALBEDO_LIMITS, F0_LIMITS
from matcap.flash.coarse.cells import BLACK, CoarseCells, Doubles, Unknowns, cells_of, signed_albedo
from matcap.flash.coarse.colour_falloff import colour_falloff
from matcap.flash.coarse.problem import (
    HUBER,
    TONE,
    WEIGHT_BETWEEN,
    WHITE,
    HighlightMeasurements,
    Problem,
    TiltPrior,
    priors,
)
from matcap.flash.diffuse_share import ACROSS, DiffuseShare, measure_diffuse_share, undeveloped
from matcap.flash.geometry import FlashSetup
from matcap.flash.highlight import Highlight, find_highlight, light_of
from matcap.flash.light import Uniform
from matcap.photo.left_out import CLIPPED_SHARE, area_averaged
from matcap.photo.photo import Photo, ToneCurve

# Cells across the long side and across the highlight's patch: of the coarse grid for all starting
# points, and of the fine one for the best.
_GRIDS = ((24, 10), (32, 16))
_FEW, _MANY = 6, 30  # most Levenberg-Marquardt iterations, of every start and of the best
_KEPT = 2  # number of best starts that are fitted on the fine grid
# Weight of one nat of the prior, in shares of the picture with residuals of HUBER, of developed
# pictures, whose model errors (tone mapping) are smooth.
_PRIOR_SHARE = 0.15
# Least log odds (nats) of a conductor. Most photographs show none, and errors of falloff or tone
# curve imitate one: black lacquer and black and brown leather have 10 to 12, bare steel 14
# (docs/notes/gloss.md).
_CONDUCTOR_ODDS = 12.0
_BLUEST = 0.1  # largest log ratio of a metal's F0 in blue to red
# Radiance of the fifth code of 8 bits, and the largest share of a developed picture below it: what
# crushed shadows hide may be diffuse (black leather 0234: 0.66; metals at most 0.01).
_FIFTH_CODE, _MOST_CRUSHED = 1.5e-3, 0.5
_DARKEST_CHANNEL = 0.01  # of albedo, over the largest
_DULLEST = 0.8  # largest roughness of a metal, as a photograph without highlight shows none

# Starting points.
# Logit of roughness: matte, satin, glossy, mirror-like.
_STARTS = (0.8, -0.4, -1.4, -2.2)
# Multiples of the roughness that a highlight's width means: clipping widens it.
_WIDTHS = (1.0, 0.6)
_MATTE = 2.5  # logit of roughness
# GGX is half its peak where the half vector's tangent is this many alpha.
_HALF_GGX = 0.644
_DISTINCT = 0.3  # starts whose logits of roughness differ by less are duplicates
# Root-mean-square log radiance by which a fit may be worse and count as equal.
_EQUAL_RESIDUAL = 0.003


@dataclass(frozen=True)
class CoarseFit(Uniform):
    """The uniform material and setup fitted to a photograph."""

    residual: float
    """Root-mean-square of the log residual over unclipped cells."""
    conductor: bool = False
    """Whether fitted as bare metal; `specular` is then the mean of its coloured F0."""
    by_hand: bool = False
    """Whether metal or dielectric was given, not measured."""
    tilt_prior: TiltPrior | None = None
    """Measurement of the tilt given as a prior, if any."""
    tone: ToneCurve = ToneCurve()
    """The picture's tone curve; the identity where it has none."""
    level_deviation: float | None = None
    """Standard deviation of log albedo over F0, the level of a dielectric's albedo; None of a
    conductor, and of fits not made from a photograph."""

    def scaled(self, factor: float) -> CoarseFit:
        """The same picture with albedo and F0 times a factor, and the flash divided by it."""
        red, green, blue = (min(factor * channel, 1.0) for channel in self.diffuse)
        specular, setup = min(factor * self.specular, 1.0), self.setup.dimmed(factor)
        return replace(self, diffuse=(red, green, blue), specular=specular, setup=setup)


class Measured(NamedTuple):
    """What a photograph is fitted by, beside its tilt."""

    highlight: Highlight | None
    cells: tuple[CoarseCells, ...]
    """On each of _GRIDS."""
    share: DiffuseShare | None

    @staticmethod
    def of(photo: Photo) -> Measured:
        """Measure a photograph."""
        highlight = find_highlight(light_of(photo.pixels))
        cells = tuple(cells_of(photo, highlight, *grid) for grid in _GRIDS)
        return Measured(highlight, cells, diffuse_share_of(photo, highlight))


def fit_coarse(
    photo: Photo,
    *,
    tilt: tuple[float, float] | None = None,
    tilt_prior: TiltPrior | None = None,
    known_metal: bool | None = None,
    measured: Measured | None = None,
) -> CoarseFit:
    """Fit a uniform material and its setup to a photograph, in about a second.

    Args:
        photo: of any size; only its low frequencies are used.
        tilt: (tilt_x, tilt_y) in radians, held fixed; None to fit them.
        tilt_prior: Gaussian measurement of the tilt, used as its prior.
        known_metal: whether it is metal, if that is known; None to decide by probability.
        measured: in the photograph; None to measure it.
    """
    highlight, (coarse, fine), share = measured or Measured.of(photo)
    problems = [
        _problem(photo, coarse, highlight, priors(photo, tilt, tilt_prior, conductor=metal), metal)
        for metal in (False, True)
    ]
    dielectric, metal = (_minima(problem, highlight, tilt) for problem in problems)
    chosen, dielectric_cost, _ = _fitted(photo, replace(problems[0], cells=fine), share, dielectric)
    crushed = float((photo.pixels.max(-1) < _FIFTH_CODE).mean())
    undecided = known_metal is None and (photo.radiometric or crushed <= _MOST_CRUSHED)
    # A conductor with the larger cost on coarse cells would have to gain all of _CONDUCTOR_ODDS.
    if known_metal or (undecided and metal[0][0] <= dielectric[0][0]):
        conductor, cost, nat = _fitted(photo, replace(problems[1], cells=fine), share, metal)
        red, _, blue = conductor.diffuse
        is_metal = (
            dielectric_cost - cost > _CONDUCTOR_ODDS * nat
            # No metal reflects blue better than red, unlike a black surface with a blue sheen.
            and math.log(blue / red) < _BLUEST
            and conductor.roughness < _DULLEST
        )
        chosen = conductor if is_metal or known_metal else chosen
    return replace(chosen, tilt_prior=tilt_prior, by_hand=known_metal is not None)


def diffuse_share_of(photo: Photo, highlight: Highlight | None) -> DiffuseShare | None:
    """Colour scatter of a photograph's rings around its highlight, or its middle without one."""
    every = max(1, round(photo.pixels.shape[1] / ACROSS))
    size = tuple(side // every for side in photo.pixels.shape[1::-1])
    seen = ~photo.clipped if photo.left_out is None else ~(photo.clipped | photo.left_out)
    pixels = area_averaged(photo.pixels, size)
    tone = None
    if photo.tone_mapped:
        pixels, tone = undeveloped(pixels, math.exp(TONE.mean))
    return measure_diffuse_share(
        pixels,
        area_averaged(seen.astype(np.float32), size) > 1.0 - CLIPPED_SHARE,
        (0.0, 0.0) if highlight is None else highlight.centre,
        noise=None if photo.noise is None else area_averaged(photo.noise, size),
        tone=tone,
        developed=not photo.radiometric,
    )


def _problem(
    photo: Photo,
    cells: CoarseCells,
    highlight: Highlight | None,
    prior: tuple[Unknowns, Unknowns],
    conductor: bool,
) -> Problem:
    """The problem of a photograph's coarse cells; the prior is (mean, standard deviation)."""
    mean, deviation = prior
    unit = _PRIOR_SHARE * HUBER**2
    measured = None if highlight is None else HighlightMeasurements(highlight, photo.headroom)
    return Problem(
        cells=cells,
        distance=FlashSetup(fov=photo.fov).distance,
        measurements=measured,
        prior=mean.vector(),
        precision=unit * np.diag(deviation.vector() ** -2),
        unit=unit,
        shoulder=photo.development.shoulder if photo.tone_mapped else None,
        conductor=conductor,
    )


def _minima(
    problem: Problem, highlight: Highlight | None, tilt: tuple[float, float] | None
) -> list[tuple[float, Doubles]]:
    """(cost, parameters) from every starting point, the least cost first."""
    initial = starts(problem, highlight, tilt_known=tilt is not None)
    minima = [problem.minimised(start, _FEW) for start in initial]
    return sorted(minima, key=lambda candidate: candidate[0])


def _fitted(
    photo: Photo,
    last: Problem,
    diffuse_share: DiffuseShare | None,
    minima: Sequence[tuple[float, Doubles]],
) -> tuple[CoarseFit, float, float]:
    """The most probable fit on fine cells, its cost, and the cost of a nat of the prior.

    `minima` are (cost, parameters) on coarse cells, the least cost first.
    """
    initial = [parameters for _, parameters in minima]
    if photo.radiometric:
        last = last.whitened(initial[0]).with_estimated_noise(initial[0])
    if diffuse_share is not None:
        # Of a flash whose colour is free, scatter could be fitted by that alone.
        flash = np.exp(Unknowns.of(initial[0]).flash)
        last = replace(last, diffuse_share=diffuse_share.under(flash))
    best = _best(last, initial)
    rest = last.differences(best)[last.cells.above == 1.0]
    residual = math.sqrt(np.square(rest).mean()) if rest.size else 0.0
    exponent = math.exp(Unknowns.of(best).tone[0])
    fit = CoarseFit(
        *_uniform(Unknowns.of(best), photo.fov, conductor=last.conductor),
        residual=residual,
        conductor=last.conductor,
        tone=ToneCurve() if last.shoulder is None else ToneCurve(exponent, last.shoulder),
        level_deviation=None if last.conductor else last.level_deviation(best, residual),
    )
    return _with_colour_falloff(fit, last, best, photo), last.cost(best), last.unit


def _with_colour_falloff(
    fit: CoarseFit, problem: Problem, best: Doubles, photo: Photo
) -> CoarseFit:
    """A dielectric's fit with the flash's colour off its axis (colour_falloff.py)."""
    if fit.conductor:
        return fit
    cells, centre = problem.cells, Unknowns.of(best).centre
    _, share = problem.log_radiance(best, cells.image)
    ratio = -problem.differences(best)
    developed = not (photo.radiometric or photo.floating)
    lost, hue = colour_falloff(ratio, cells, share.value, centre, developed=developed)
    # The tone curve was applied to the residuals.
    steep = math.exp(Unknowns.of(best).tone[0]) if problem.shoulder is not None else 1.0
    red, green, blue = (np.array(fit.diffuse) * np.exp(hue / steep)).clip(None, 1.0).tolist()
    by_red, by_green, by_blue = (lost / steep).tolist()
    setup = replace(fit.setup, vignetting_colour=(by_red, by_green, by_blue))
    return replace(fit, diffuse=(red, green, blue), setup=setup)


def _best(problem: Problem, tried: Sequence[Doubles]) -> Doubles:
    """The best parameters from several starts, the best start first."""
    distinct_starts = distinct(tried)[:_KEPT]
    if problem.cells.hidden:
        unknowns = Unknowns.of(tried[0])
        distinct_starts.append(replace(unknowns, roughness=np.array([_MATTE])).vector())
    minima = [problem.minimised(each, _MANY)[1] for each in distinct_starts]
    strict = problem
    if problem.measurements is not None:
        strict = replace(problem, measurements=replace(problem.measurements, weight=WEIGHT_BETWEEN))
    return roughest([(strict.cost(each), each) for each in minima])


def _uniform(
    best: Unknowns, fov: float, *, conductor: bool
) -> tuple[tuple[float, float, float], float, float, FlashSetup]:
    """Diffuse albedo, F0, roughness and setup of fitted parameters."""
    signed, _ = signed_albedo(best.albedo)
    albedo = np.log(np.maximum(signed, _DARKEST_CHANNEL * signed.max())).tolist()
    specular = float(best.specular[0])
    if conductor:
        specular = math.log(np.exp(best.albedo).mean())
        albedo = (best.albedo + math.log(BLACK)).tolist()
    # Only the product with the flash's intensity is measured: limit albedo, raise the intensity.
    excess = max(0.0, max(*albedo, specular) - math.log(WHITE))
    red, green, blue = (math.exp(value - excess) for value in albedo)
    flash_red, flash_green, flash_blue = np.exp(best.flash + excess).tolist()
    across, up = best.offset.tolist()
    tilt_x, tilt_y = best.tilt.tolist()
    squared, quartic = best.vignetting.tolist()
    right, above = best.centre.tolist()
    setup = FlashSetup(
        fov=fov,
        offset=(across, up, 0.0),
        tilt=(tilt_x, tilt_y),
        intensity=(flash_red, flash_green, flash_blue),
        vignetting=squared,
        vignetting_quartic=quartic,
        vignetting_centre=(right, above),
    )
    roughness = 1.0 / (1.0 + math.exp(-best.roughness[0]))
    return (red, green, blue), math.exp(specular - excess), roughness, setup


def rescale_to_flash(coarse: CoarseFit, intensity: float | None) -> CoarseFit:
    """The fit rescaled to a known flash intensity, which makes albedo and F0 absolute.

    Args:
        coarse: the fit, with its estimate of the intensity.
        intensity: measured by a calibration card, in units of linear pixel values; None returns the
            fit unchanged.
    """
    if intensity is None:
        return coarse
    dimmer = coarse.setup.intensity[1] / intensity
    red, green, blue = (min(value * dimmer, ALBEDO_LIMITS[1]) for value in coarse.diffuse)
    return replace(
        coarse,
        diffuse=(red, green, blue),
        specular=min(coarse.specular * dimmer, F0_LIMITS[1]),
        setup=coarse.setup.with_intensity((intensity,) * 3),
    )


def starts(problem: Problem, highlight: Highlight | None, *, tilt_known: bool) -> Iterable[Doubles]:
    """Starting points whose brightness and colour already fit the photograph's median.

    Radiance there is about albedo / pi intensity / distance^2; a conductor's is darker, away from
    its highlight.
    """
    mean, distance = Unknowns.of(problem.prior), problem.distance
    median = np.quantile(problem.cells.observed, 0.5, axis=1, method="lower")
    brightness = median.mean()
    intensity = brightness - mean.albedo[:1] + math.log(math.pi) + 2.0
    logits, places = list(_STARTS), [mean]
    if highlight is not None:
        alpha = min(highlight.width / (_HALF_GGX * distance), 0.6)
        roughnesses = [share * math.sqrt(alpha) for share in _WIDTHS]
        logits = [_STARTS[0], *(math.log(one / (1.0 - one)) for one in roughnesses)]
        u, v = highlight.centre
        tilt_x, tilt_y = mean.tilt.tolist()
        across, up = u + distance * math.tan(tilt_y), v - distance * math.tan(tilt_x)
        shifted = replace(mean, offset=np.array([2.0 * across, 2.0 * up]))
        turned = replace(mean, tilt=np.array([v, -u]) / distance)
        places = [shifted] if tilt_known else [shifted, turned]
    for place in places:
        for logit in logits:
            yield replace(
                place,
                albedo=mean.albedo + (median - brightness),
                roughness=np.array([logit]),
                intensity=intensity + (1.5 if problem.conductor else 0.0),
            ).vector()


def distinct(fits: Sequence[Doubles]) -> list[Doubles]:
    """Parameters, the best first, without those of nearly the same roughness as better ones."""
    kept: list[Doubles] = []
    for candidate in fits:
        roughness = _roughness(candidate)
        if all(abs(roughness - _roughness(one)) > _DISTINCT for one in kept):
            kept.append(candidate)
    return kept


def roughest(fits: Sequence[tuple[float, Doubles]]) -> Doubles:
    """The roughest among fits (cost, parameters) of nearly equal cost, so that no highlight is
    invented in clipped areas.
    """
    least = min(cost for cost, _ in fits)
    equal = [candidate for cost, candidate in fits if cost <= least + 0.5 * _EQUAL_RESIDUAL**2]
    return max(equal, key=_roughness)


def _roughness(parameters: Doubles) -> float:
    """Logit of roughness."""
    return float(Unknowns.of(parameters).roughness[0])
