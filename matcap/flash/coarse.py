"""The coarse fit: uniform reflectance, camera and flash from a photograph's low frequencies.

Its accuracy is measured in docs/notes/capture.md.

A flat, uniform material under a flash is fitted to the blurred photograph by robust least squares
on the logarithm of radiance: albedo or F0, roughness, flash intensity and offset, tilt, falloff of
lens and flash. It is fitted twice, as a dielectric (F0 near 0.04, any albedo) and as a conductor
(no diffuse albedo, coloured F0); the lower cost, prior shares included, decides. One wide prior of
F0 cannot: it makes black lacquer metal, and metal a matte surface under a narrow flash.
The picture is averaged over coarse cells, and the highlight, which may be smaller than one of
them, over a patch of cells of its own scale. Clipped cells are lower bounds. Weak priors resolve
ambiguities of one photograph: flash intensity against albedo, tilt against flash offset, contrast
of a tone curve (photo/tone.py) against falloff. The highlight's centre measures tilt and offset:
it is the mirror point. Several starting points, because of local minima.

Texture is not modelled. Relief widens the highlight, so the roughness is an upper estimate, which
later stages lower.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from matcap.flash.geometry import FlashSetup, rotation
from matcap.flash.highlight import SURROUNDINGS, Highlight, find_highlight, light_of
from matcap.flash.light import FlashLight, log_vignette
from matcap.flash.rectify import CLIPPING
from matcap.flash.uniform import Uniform
from matcap.photo.camera import Falloff
from matcap.photo.photo import Photo
from matcap.photo.tone import SHOULDER, ToneCurve

_STEP = 1e-5  # of finite differences in parameters, all of which are of order 1
_DARKEST = 1e-12  # radiance added before logarithms


@dataclass(frozen=True)
class CoarseSettings:
    """Settings of the coarse fit; measurements in docs/notes/capture.md.

    Attributes:
        cells: cells across the long side, on the coarse grid for all starting points and the fine
            one for the best.
        patch_cells: the same across the highlight's patch.
        patch_reach: half side of the patch, in half widths of the highlight.
        patch_weight: least weight of the patch; that of the whole picture is 1.
        left_out: largest masked share of a cell.
        knee_developed, knee_radiometric: radiance (1 at clipping) above which cells are lower
            bounds: development compresses bright tones below clipping, RAW is linear up to it.
        above_knee: factor on the residual of a model brighter than such a cell.
        huber: threshold of the Huber loss, log radiance.
        iterations: most Levenberg-Marquardt iterations, of every start and of the best.
        kept: number of best starts that are fitted on the fine grid.
        distinct: starts whose logits of roughness differ by less are duplicates.
        tilt_radiometric: prior standard deviation of the tilt of a RAW, radians; larger than that
            of developed pictures, whose tone curve looks like tilt.
        hidden: share of cells clipped in all channels above which a matte start is added.
        alike: root-mean-square log radiance by which a fit may be worse and count as equal.
        crushed: share of a developed cell's brightest channel added to all of them before the
            logarithm, as dark channels of saturated colours are clipped by the colour space.
        brightening: prior standard deviation of negative falloff, which ambient light imitates.
        black: diffuse albedo of a conductor over its F0.
        conductor_odds: least log odds (nats) of a conductor. Most photographs show none, and errors
            of falloff or tone curve imitate one: black lacquer and black and brown leather have 10
            to 12, bare steel 14 (docs/notes/gloss.md).
        bluest: largest log ratio of a metal's F0 in blue to red.
        dullest: largest roughness of a metal, as a photograph without highlight shows none.
        brightest: upper limit of mean albedo or F0.
        most_albedo: upper limit of albedo and F0 under a known flash intensity.
        prior_share_developed: weight of one nat of the prior, in shares of the picture with
            residuals of `huber`, of developed pictures, whose model errors (tone mapping) are
            smooth.
        cells_that_count: number of residuals per nat of the prior in a RAW, chosen empirically;
            about the number of cells, whose whitened channels are independent.
        centre_deviation: standard deviation of the highlight's centre from the mirror point: plane
            units, plus a share of its half width.
        middle_deviation: the same of the centre of its half-way ring.
        level_deviation: standard deviation, log radiance, of peak, half-way level and surroundings.
        evidence_developed, evidence_radiometric: weight of the highlight's seven measurements; in a
            RAW they only help convergence, a tone curve changes the surroundings.
        evidence_between: the same weight where one of several minima is chosen: laminate, whose
            sharp highlight covers few cells, would else be satin under a narrow flash.
        directions: points of a ring.
        colour_noise: log radiance, least standard deviation of differences of channels.
        texture_at_most: log radiance; residuals are clipped to +-this before whitening.
        least_whole_cells: least number of unclipped cells for whitening.
    """

    cells: tuple[int, int] = (24, 32)
    patch_cells: tuple[int, int] = (10, 16)
    patch_reach: float = 2.0
    patch_weight: float = 0.5
    left_out: float = 0.02
    knee_developed: float = 0.8
    knee_radiometric: float = 0.95
    above_knee: float = 0.25
    huber: float = 0.1
    iterations: tuple[int, int] = (6, 30)
    kept: int = 2
    distinct: float = 0.3
    tilt_radiometric: float = 0.1
    hidden: float = 0.02
    alike: float = 0.003
    crushed: float = 0.02
    brightening: float = 0.02
    black: float = 0.005
    conductor_odds: float = 12.0
    bluest: float = 0.1
    dullest: float = 0.8
    brightest: float = 0.8
    most_albedo: float = 0.98
    prior_share_developed: float = 0.15
    cells_that_count: float = 600.0
    centre_deviation: tuple[float, float] = (0.006, 0.1)
    middle_deviation: tuple[float, float] = (0.004, 0.03)
    level_deviation: float = 0.1
    evidence_developed: float = 0.005
    evidence_radiometric: float = 0.005
    evidence_between: float = 0.05
    directions: int = 12
    colour_noise: float = 0.01
    texture_at_most: float = 0.5
    least_whole_cells: int = 30


COARSE = CoarseSettings()


@dataclass(frozen=True)
class TiltPrior:
    """A Gaussian measurement of both tilt angles from elsewhere (space/alignment.py).

    Attributes:
        mean: (tilt_x, tilt_y) in radians.
        std: their standard deviations, radians.
    """

    mean: tuple[float, float]
    std: tuple[float, float]

    def times(self, mean: Tensor, std: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation of its product with another Gaussian, (2,) each."""
        own, other = _numbers(*self.std).pow(-2), std.pow(-2)
        precision = own + other
        return (own * _numbers(*self.mean) + other * mean) / precision, precision.rsqrt()


@dataclass(frozen=True)
class FalloffEvidence:
    """Gaussian likelihood of the falloff x = (a, b): exp(h x - x L x / 2).

    Attributes:
        shift: (2,) h = L times the most likely x.
        precision: elements aa, ab and bb of L.
    """

    shift: tuple[float, float]
    precision: tuple[float, float, float]


@dataclass(frozen=True)
class CoarseFit(Uniform):
    """The uniform material and setup fitted to a photograph.

    Attributes:
        residual: root-mean-square of the log residual over unclipped cells.
        conductor: whether fitted as bare metal; `specular` is then the mean of its coloured F0.
        lobes: (share, roughness) of the best two-lobe fit of the highlight, the narrow lobe
            first; `roughness` is of the best single lobe.
        tilt_prior: measurement of the tilt given as a prior, if any.
        picture_tilt: (tilt_x, tilt_y) fitted without that prior, radians; None without one.
        tone: the picture's tone curve; the identity where it has none.
        falloff: likelihood of the falloff; None of fits not made from a photograph.
    """

    residual: float
    lobes: tuple[tuple[float, float], ...] = ()
    conductor: bool = False
    tilt_prior: TiltPrior | None = None
    picture_tilt: tuple[float, float] | None = None
    tone: ToneCurve = ToneCurve()
    falloff: FalloffEvidence | None = None


@dataclass(frozen=True)
class Unknowns:
    """The fitted parameters, scaled to order 1; of one specular lobe or, with `share`, of two.

    Attributes:
        albedo: (3,) log of diffuse albedo; of a conductor, log of F0.
        specular: (1,) log of a dielectric's F0.
        roughness: (1,) logit; of the narrow lobe, if there are two.
        intensity: (1,) log of the flash's, in green.
        hue: (2,) log of the flash's intensity in red and in blue over that.
        offset: (2,) of the flash from the camera, plane units.
        tilt: (2,) radians.
        vignetting: (2,) with r^2 and with r^4, as FlashSetup has them.
        tone: (1,) log of the tone curve's exponent.
        share: (1,) logit of the narrow lobe's, or None.
        wider: (1,) log of how much further the other's logit of roughness is, or None.
    """

    albedo: Tensor
    specular: Tensor
    roughness: Tensor
    intensity: Tensor
    hue: Tensor
    offset: Tensor
    tilt: Tensor
    vignetting: Tensor
    tone: Tensor
    share: Tensor | None = None
    wider: Tensor | None = None

    def vector(self) -> Tensor:
        """(15,), or (17,) of two lobes."""
        parts = (getattr(self, f.name) for f in fields(self))
        return torch.cat([part for part in parts if part is not None])

    @staticmethod
    def of(vector: Tensor) -> Unknowns:
        """The inverse of vector()."""
        one_lobe = (3, 1, 1, 1, 2, 2, 2, 2, 1)
        return Unknowns(
            *vector.split(one_lobe if len(vector) == sum(one_lobe) else (*one_lobe, 1, 1))
        )

    @property
    def flash(self) -> Tensor:
        """(3,) log of the flash's intensity by channel."""
        red, blue = (self.intensity + self.hue).split(1)
        return torch.cat([red, self.intensity, blue])

    @property
    def lobes(self) -> list[tuple[Tensor | float, Tensor]]:
        """Share and roughness of each lobe, the narrow one first."""
        narrow = torch.sigmoid(self.roughness)
        if self.share is None or self.wider is None:
            return [(1.0, narrow)]
        share = torch.sigmoid(self.share)
        return [(share, narrow), (1.0 - share, torch.sigmoid(self.roughness + self.wider.exp()))]


def _numbers(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


_DIELECTRIC_MEAN = Unknowns(
    albedo=_numbers(*[math.log(0.2)] * 3),
    specular=_numbers(math.log(0.04)),
    roughness=_numbers(0.0),
    intensity=_numbers(3.0),
    hue=_numbers(0.0, 0.0),
    offset=_numbers(0.0, 0.0),
    tilt=_numbers(0.0, 0.0),
    vignetting=_numbers(0.0, 0.0),
    tone=_numbers(0.12),
)
_DIELECTRIC_DEVIATION = Unknowns(
    albedo=_numbers(1.5, 1.5, 1.5),
    specular=_numbers(0.15),
    roughness=_numbers(1.5),
    intensity=_numbers(5.0),
    hue=_numbers(0.3, 0.3),  # white balance is the whole picture's, not the flash's
    offset=_numbers(0.12, 0.12),
    tilt=_numbers(0.05, 0.05),
    vignetting=_numbers(1.0, 1.0),
    tone=_numbers(0.08),
)
_CONDUCTOR_F0 = (math.log(0.5), 0.5)
# Of two lobes beside.
_PARTED_MEAN = {"share": _numbers(0.0), "wider": _numbers(0.0)}
_PARTED_DEVIATION = {"share": _numbers(1.5), "wider": _numbers(0.7)}
_INDEX = Unknowns.of(torch.arange(15))  # of each unknown in vector(), of two lobes as well
_FALLOFF = _INDEX.vignetting
# Logit of roughness: matte, satin, glossy, mirror-like.
_STARTS = (0.8, -0.4, -1.4, -2.2)
# Multiples of the roughness that a highlight's width means: clipping widens it.
_WIDTHS = (1.0, 0.6)
_MATTE = 2.5  # logit of roughness
# GGX is half its peak where the half vector's tangent is this many alpha.
_HALF_GGX = 0.644


@dataclass(frozen=True)
class _Cells:
    """Observations of the fit: averages of the photograph over n cells.

    Attributes:
        image: (2, n) image coordinates of the cells.
        observed: (3, n) log radiance.
        toe: (3, n) radiance added to cell and model before the logarithm, as darker values are
            uncertain.
        above: (3, n) factor on the residual of a model brighter than the cell: 1, or less for
            lower bounds.
        weight: (n,) weight of each cell; they sum to 1/3.
    """

    image: Tensor
    observed: Tensor
    toe: Tensor
    above: Tensor
    weight: Tensor

    @property
    def hidden(self) -> bool:
        """Whether clipped cells may hide a highlight."""
        return float(self.weight[(self.above == 0.0).all(0)].sum()) > COARSE.hidden / 3.0

    def differences(self, log_radiance: Tensor) -> Tensor:
        """(3, n) log radiance of a model less that of the cells, with toe."""
        return (log_radiance.exp() + self.toe).log() - self.observed


def fit_coarse(
    photo: Photo,
    *,
    tilt: tuple[float, float] | None = None,
    tilt_prior: TiltPrior | None = None,
) -> CoarseFit:
    """Fit a uniform material and its setup to a photograph, in about a second.

    The prior of the falloff is the profile of the photograph's camera, or any phone's.

    Args:
        photo: of any size; only its low frequencies are used.
        tilt: (tilt_x, tilt_y) in radians, held fixed; None to fit them.
        tilt_prior: Gaussian measurement of the tilt, used as its prior.
    """
    highlight = find_highlight(light_of(photo.pixels))
    cells = tuple(_see(photo, highlight, level) for level in range(len(COARSE.cells)))
    dielectric, conductor = (
        _fit_as(photo, cells, highlight, _prior(photo, tilt, tilt_prior, conductor=metal))
        for metal in (False, True)
    )
    odds = (dielectric.cost - conductor.cost) / conductor.unit - COARSE.conductor_odds
    red, _, blue = conductor.best.albedo.tolist()
    # No metal reflects blue better than red, unlike a black surface with a blue sheen.
    is_metal = odds > 0.0 and blue < red + COARSE.bluest
    is_metal &= float(torch.sigmoid(conductor.best.roughness)) < COARSE.dullest
    chosen = conductor if is_metal else dielectric
    fit = _coarse_fit(chosen, photo.fov)
    return replace(fit, tilt_prior=tilt_prior, picture_tilt=chosen.own_tilt)


@dataclass(frozen=True)
class _Prior:
    """A hypothesis: Gaussian prior of the unknowns, and whether they are a conductor's.

    `precision` is (15, 15), the inverse covariance. `alone` is the tilt's mean and deviation
    without a measurement of it, where there is one.
    """

    mean: Unknowns
    precision: Tensor
    conductor: bool
    at_lens: bool
    alone: tuple[Tensor, Tensor] | None


@dataclass(frozen=True)
class _Fitted:
    """Fit under one hypothesis: cost, cost of one nat of the prior, parameters.

    `own_tilt` is the tilt fitted without its measurement, radians.
    """

    cost: float
    unit: float
    best: Unknowns
    both: Unknowns
    residual: float
    conductor: bool
    own_tilt: tuple[float, float] | None
    tone: ToneCurve
    falloff: FalloffEvidence


def _prior(
    photo: Photo,
    tilt: tuple[float, float] | None,
    tilt_prior: TiltPrior | None,
    *,
    conductor: bool,
) -> _Prior:
    falloff = Falloff() if photo.profile is None else photo.profile.falloff
    mean = replace(_DIELECTRIC_MEAN, vignetting=_numbers(*falloff.mean))
    deviation = _DIELECTRIC_DEVIATION
    if conductor:
        level, scatter = _CONDUCTOR_F0
        mean = replace(mean, albedo=_numbers(*[level] * 3))
        deviation = replace(deviation, albedo=_numbers(*[scatter] * 3))
    # A conductor colours all that it reflects; RAW and cards are white under the flash.
    if conductor or photo.radiometric or photo.flash_intensity is not None:
        deviation = replace(deviation, hue=_numbers(1e-4, 1e-4))
    if photo.radiometric:
        leaning = _numbers(COARSE.tilt_radiometric, COARSE.tilt_radiometric)
        deviation = replace(deviation, tilt=leaning)
    alone = None
    if tilt is not None:
        mean = replace(mean, tilt=_numbers(*tilt))
        deviation = replace(deviation, tilt=_numbers(1e-4, 1e-4))
    elif tilt_prior is not None:
        alone = (mean.tilt, deviation.tilt)
        place, std = tilt_prior.times(*alone)
        mean, deviation = replace(mean, tilt=place), replace(deviation, tilt=std)
    precision = torch.diag(deviation.vector().pow(-2))
    precision[_FALLOFF[:, None], _FALLOFF] = torch.from_numpy(falloff.precision)
    return _Prior(mean, precision, conductor, tilt is not None, alone)


def _fit_as(
    photo: Photo, cells: Sequence[_Cells], highlight: Highlight | None, prior: _Prior
) -> _Fitted:
    """The most probable parameters under one hypothesis."""
    distance = FlashSetup(fov=photo.fov).distance
    evidence = COARSE.evidence_radiometric if photo.radiometric else COARSE.evidence_developed
    unit = COARSE.prior_share_developed * COARSE.huber**2
    first, last = (
        _Problem(
            cells=each,
            distance=distance,
            highlight=highlight,
            evidence=evidence,
            rings=_rings(highlight),
            prior=prior.mean.vector(),
            precision=unit * prior.precision,
            unit=unit,
            shoulder=SHOULDER if photo.tone_mapped else 0.0,
            conductor=prior.conductor,
        )
        for each in cells
    )
    starts = _starts(first.cells.observed, prior, highlight, distance)
    tried = [_levenberg_marquardt(first, start, COARSE.iterations[0]) for start in starts]
    tried.sort(key=lambda candidate: candidate[0])
    if photo.radiometric:
        last = last.whitened(tried[0][1])
        last = last.trusting(tried[0][1])
    worth = _distinct([start for _, start in tried])[: COARSE.kept]
    if last.cells.hidden:
        worth.append(_matte(tried[0][1]))
    minima = [_levenberg_marquardt(last, each, COARSE.iterations[1])[1] for each in worth]
    strict = replace(last, evidence=COARSE.evidence_between)
    single = _mattest([(strict.cost(each), each) for each in minima])
    # Two lobes locate the highlight better; then one lobe is fitted there.
    two = last.with_two_lobes()
    both = Unknowns.of(_levenberg_marquardt(two, _parted(single), COARSE.iterations[1])[1])
    start = replace(
        Unknowns.of(single), offset=both.offset, tilt=both.tilt, vignetting=both.vignetting
    )
    whole, last = last, last.at(both)
    cost, best = _levenberg_marquardt(last, start.vector(), COARSE.iterations[1])
    difference = last.cells.differences(last.log_radiance(best, last.cells.image))
    rest = difference[last.cells.above == 1.0]
    residual = float(rest.square().mean().sqrt()) if rest.numel() else 0.0
    own = None
    if prior.alone is not None:
        without = whole.with_tilt(*prior.alone)
        unmeasured = Unknowns.of(_levenberg_marquardt(without, best, COARSE.iterations[0])[1])
        tilt_x, tilt_y = unmeasured.tilt.tolist()
        own = (tilt_x, tilt_y)
    exponent = math.exp(float(Unknowns.of(best).tone))
    tone = ToneCurve(exponent, last.shoulder) if last.shoulder > 0.0 else ToneCurve()
    return _Fitted(
        cost=cost,
        unit=last.unit,
        best=Unknowns.of(best),
        both=both,
        residual=residual,
        conductor=prior.conductor,
        own_tilt=own,
        tone=tone,
        falloff=last.falloff_evidence(best),
    )


def _coarse_fit(fitted: _Fitted, fov: float) -> CoarseFit:
    best = fitted.best
    albedo, specular = best.albedo.tolist(), float(best.specular)
    if fitted.conductor:
        specular = float(best.albedo.exp().mean().log())
        albedo = [value + math.log(COARSE.black) for value in albedo]
    # Only the product with the flash's intensity is measured: limit albedo, raise the intensity.
    excess = max(0.0, max(*albedo, specular) - math.log(COARSE.brightest))
    red, green, blue = (math.exp(value - excess) for value in albedo)
    flash_red, flash_green, flash_blue = (best.flash + excess).exp().tolist()
    across, up = best.offset.tolist()
    tilt_x, tilt_y = best.tilt.tolist()
    squared, quartic = best.vignetting.tolist()
    return CoarseFit(
        diffuse=(red, green, blue),
        specular=math.exp(specular - excess),
        roughness=1.0 / (1.0 + math.exp(-float(best.roughness))),
        setup=FlashSetup(
            fov=fov,
            offset=(across, up, 0.0),
            tilt=(tilt_x, tilt_y),
            intensity=(flash_red, flash_green, flash_blue),
            vignetting=squared,
            vignetting_quartic=quartic,
        ),
        residual=fitted.residual,
        lobes=tuple((float(share), float(wide)) for share, wide in fitted.both.lobes),
        conductor=fitted.conductor,
        tone=fitted.tone,
        falloff=fitted.falloff,
    )


def under_flash(coarse: CoarseFit, intensity: float | None) -> CoarseFit:
    """The fit rescaled to a known flash intensity, which makes albedo and F0 absolute.

    Args:
        coarse: the fit, with its estimate of the intensity.
        intensity: measured by a calibration card, in units of linear pixel values; None returns the
            fit unchanged.
    """
    if intensity is None:
        return coarse
    dimmer = coarse.setup.intensity[1] / intensity
    red, green, blue = (min(value * dimmer, COARSE.most_albedo) for value in coarse.diffuse)
    return replace(
        coarse,
        diffuse=(red, green, blue),
        specular=min(coarse.specular * dimmer, COARSE.most_albedo),
        setup=coarse.setup.with_intensity((intensity,) * 3),
    )


def render_coarse(fit: CoarseFit, width: int, height: int) -> NDArray[np.float64]:
    """(height, width, 3) linear rendering of a coarse fit, the photograph's tone curve applied."""
    across, up, _ = fit.setup.offset
    unknowns = Unknowns(
        albedo=_numbers(*fit.diffuse).log(),
        specular=_numbers(fit.specular).log(),
        roughness=_numbers(fit.roughness).logit(),
        intensity=_numbers(fit.setup.intensity[1]).log(),
        hue=_numbers(fit.setup.intensity[0], fit.setup.intensity[2]).log()
        - math.log(fit.setup.intensity[1]),
        offset=_numbers(across, up),
        tilt=_numbers(*fit.setup.tilt),
        vignetting=_numbers(fit.setup.vignetting, fit.setup.vignetting_quartic),
        tone=_numbers(0.0),
    )
    image = _image_grid(width, height).flatten(1)
    light = _log_radiance(unknowns.vector(), image, fit.setup.distance).exp()
    picture = np.ascontiguousarray(light.reshape(3, height, width).permute(1, 2, 0).numpy())
    return fit.tone.developed(picture)


def _see(photo: Photo, highlight: Highlight | None, level: int) -> _Cells:
    """Cells of the whole photograph; over the highlight's patch, fine ones replace the coarse."""
    rows, columns = photo.pixels.shape[:2]
    pixel = 2.0 / columns
    across = min(COARSE.cells[level], columns)
    size = (across, max(4, round(across * rows / columns)))
    whole = _cells(photo, (0, 0, columns, rows), size)
    if not whole.weight.any():
        # Every cell has masked pixels: the mask is so fine that its fill is from nearby.
        photo = replace(photo, left_out=None)
        whole = _cells(photo, (0, 0, columns, rows), size)
    if highlight is None:
        return whole
    reach = COARSE.patch_reach * highlight.width
    u, v = highlight.centre
    left, right = (round((u + side + 1.0) / pixel) for side in (-reach, reach))
    top, bottom = (round((rows / columns - v + side) / pixel) for side in (-reach, reach))
    left, top, right, bottom = max(0, left), max(0, top), min(columns, right), min(rows, bottom)
    if right - left < 4 or bottom - top < 4:
        return whole
    fine = COARSE.patch_cells[level] / (2.0 * reach / pixel)
    size = (
        min(right - left, max(4, round(fine * (right - left)))),
        min(bottom - top, max(4, round(fine * (bottom - top)))),
    )
    patch = _cells(photo, (left, top, right, bottom), size)
    outside = (whole.image[0] < left * pixel - 1.0) | (whole.image[0] > right * pixel - 1.0)
    outside |= (whole.image[1] > rows / columns - top * pixel) | (
        whole.image[1] < rows / columns - bottom * pixel
    )
    if not outside.any():
        return patch
    share = float(outside.double().mean())
    return _Cells(
        torch.cat([whole.image[:, outside], patch.image], dim=1),
        torch.cat([whole.observed[:, outside], patch.observed], dim=1),
        torch.cat([whole.toe[:, outside], patch.toe], dim=1),
        torch.cat([whole.above[:, outside], patch.above], dim=1),
        torch.cat(
            [whole.weight[outside], patch.weight * max(1.0 - share, COARSE.patch_weight)],
        ),
    )


def _cells(photo: Photo, box: tuple[int, int, int, int], size: tuple[int, int]) -> _Cells:
    """A rectangle (left, top, right, bottom) of a photograph, blurred to (width, height) cells."""
    left, top, right, bottom = box
    rows, columns = photo.pixels.shape[:2]
    pixels = photo.pixels[top:bottom, left:right]
    small = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA).astype(np.float64)
    full = photo.clipped[top:bottom, left:right, None] & (pixels > CLIPPING)
    clipped = cv2.resize(full.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.02
    knee = COARSE.knee_radiometric if photo.radiometric else COARSE.knee_developed
    above = np.where(clipped, 0.0, np.where(small > knee, COARSE.above_knee, 1.0))
    if photo.radiometric:
        above = np.where(above < 1.0, 0.0, 1.0)
    toe = np.full_like(small, 1e-3 * float(np.median(photo.pixels[::8, ::8])) + 1e-9)
    if not photo.radiometric:
        toe += COARSE.crushed * small.max(axis=2, keepdims=True)
    u = (left + (np.arange(size[0]) + 0.5) * (right - left) / size[0]) * 2.0 / columns - 1.0
    v = (rows - 2.0 * (top + (np.arange(size[1]) + 0.5) * (bottom - top) / size[1])) / columns
    image = np.stack(np.broadcast_arrays(u[None, :], v[:, None])).reshape(2, -1)
    count = size[0] * size[1]

    def flat(field: NDArray[np.float64]) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(field.reshape(count, 3).T))

    weight = torch.full((count,), 1.0 / (3.0 * count), dtype=torch.float64)
    if photo.left_out is not None:
        part = photo.left_out[top:bottom, left:right].astype(np.float32)
        share = cv2.resize(part, size, interpolation=cv2.INTER_AREA).ravel()
        kept = torch.from_numpy(share < COARSE.left_out).double()
        # The sum of weights is that without a mask, or 0 if no cell is left.
        weight = weight * kept * (count / max(float(kept.sum()), 1.0))
    return _Cells(
        torch.from_numpy(image), flat(np.log(small + toe)), flat(toe), flat(above), weight
    )


def _circle() -> Tensor:
    """(2, directions) unit vectors at equal angles."""
    turn = torch.arange(COARSE.directions, dtype=torch.float64) * (
        2.0 * math.pi / COARSE.directions
    )
    return torch.stack([turn.cos(), turn.sin()])


def _rings(highlight: Highlight | None) -> Tensor:
    """(2, 3 * directions) image coordinates at the highlight's centre, half width and outside."""
    if highlight is None:
        return torch.zeros(2, 0, dtype=torch.float64)
    circle = _circle()
    radii = (0.0, highlight.width, 0.5 * sum(SURROUNDINGS))
    centre = torch.tensor(highlight.centre, dtype=torch.float64)[:, None]
    return torch.cat([centre + radius * circle for radius in radii], dim=1)


def _mirror(parameters: Tensor, distance: float) -> Tensor:
    """(2,) image coordinates of the mirror point."""
    normal, camera, light = _places(Unknowns.of(parameters), distance)
    height_camera, height_light = (normal * camera).sum(), (normal * light).sum()
    foot_camera, foot_light = camera - height_camera * normal, light - height_light * normal
    point = (foot_camera * height_light + foot_light * height_camera) / (
        height_camera + height_light
    )
    return point[:2] * (distance / (distance - point[2]))


@dataclass(frozen=True)
class _Problem:
    """The function to minimise: Huber cost of weighted residuals plus that of a Gaussian prior.

    Attributes:
        cells: observations.
        distance: of the camera.
        highlight: whose centre is evidence, or None.
        evidence: its weight, as share of the picture's.
        rings: (2, 3 * directions) image coordinates: its middle, half width and surroundings.
        prior: (n,) the prior's mean, of 15 or 17 parameters.
        precision: (n, n) Hessian of the prior's cost.
        unit: cost of a nat of the prior.
        shoulder: of the tone curve; 0 without one.
        whitening: (3, 3) of the channels of cells that no bound concerns; None for as they are.
        conductor: `albedo` of the parameters is F0, and nothing is diffuse.
    """

    cells: _Cells
    distance: float
    highlight: Highlight | None
    evidence: float
    rings: Tensor
    prior: Tensor
    precision: Tensor
    unit: float
    shoulder: float = 0.0
    whitening: Tensor | None = None
    conductor: bool = False

    def log_radiance(self, parameters: Tensor, image: Tensor) -> Tensor:
        """(3, n) log radiance at image coordinates (2, n), tone curve included."""
        linear = _log_radiance(parameters, image, self.distance, conductor=self.conductor)
        if self.shoulder == 0.0:  # no tone curve, whatever the exponent
            return linear
        # The logarithm of ToneCurve.developed().
        power = Unknowns.of(parameters).tone.exp() * linear
        return power - (1.0 + self.shoulder * power.expm1()).log()

    def whitened(self, parameters: Tensor) -> _Problem:
        """The problem with channels whitened by the residuals at `parameters`.

        Light is common to all channels, texture is not: channel differences separate the two.
        """
        cells = self.cells
        whole = (cells.above == 1.0).all(0)
        if int(whole.sum()) < COARSE.least_whole_cells:
            return self
        rest = cells.differences(self.log_radiance(parameters, cells.image))
        return replace(self, whitening=_whitening(rest[:, whole], cells.weight[whole]))

    def trusting(self, parameters: Tensor) -> _Problem:
        """The problem with the prior's weight set from the residuals of a first fit."""
        count = self.cells.observed.numel()
        rest = self.residuals(parameters)[:count].clamp(-0.5, 0.5)
        variance = (self.weight[:count] * rest.square()).sum() / self.weight[:count].sum()
        nat = float(variance) / COARSE.cells_that_count
        return replace(self, precision=self.precision * (nat / self.unit), unit=nat)

    def with_two_lobes(self) -> _Problem:
        """The problem with two specular lobes: a share of the narrow one, and a wider one."""
        mean = replace(Unknowns.of(self.prior), **_PARTED_MEAN).vector()
        parted = torch.cat([each.pow(-2) for each in _PARTED_DEVIATION.values()])
        precision = torch.block_diag(self.precision, self.unit * torch.diag(parted))
        return replace(self, prior=mean, precision=precision)

    def with_tilt(self, mean: Tensor, std: Tensor) -> _Problem:
        """The problem with another Gaussian prior of the tilt, (2,) each."""
        precision = self.precision.clone()
        precision[_INDEX.tilt, _INDEX.tilt] = self.unit * std.pow(-2)
        return replace(
            self, prior=replace(Unknowns.of(self.prior), tilt=mean).vector(), precision=precision
        )

    def at(self, place: Unknowns) -> _Problem:
        """The same with offset and tilt held."""
        fixed, precision = torch.cat([_INDEX.offset, _INDEX.tilt]), self.precision.clone()
        precision[fixed, fixed] = 1e6
        prior = replace(Unknowns.of(self.prior), offset=place.offset, tilt=place.tilt)
        return replace(self, prior=prior.vector(), precision=precision)

    @property
    def weight(self) -> Tensor:
        """(residuals,) weight of each residual."""
        each = self.cells.weight.repeat(3)
        if self.highlight is None:
            return each
        return torch.cat([each, torch.full((7,), self.evidence, dtype=each.dtype)])

    def _evidence(self, parameters: Tensor, highlight: Highlight) -> Tensor:
        """(7,) scaled residuals of mirror point (2), ring symmetry (2), peak, ring, surroundings.

        The mirror point converges from any distance, but is only near the centre of a wide
        highlight; the symmetry of the half-width ring is exact.
        """
        centre = torch.tensor(highlight.centre, dtype=parameters.dtype)
        deviation = COARSE.centre_deviation[0] + COARSE.centre_deviation[1] * highlight.width
        place_error = (_mirror(parameters, self.distance) - centre) / deviation
        radiance = self.log_radiance(parameters, self.rings).exp()
        light = radiance.clamp_max(max(1.0, highlight.peak)).mean(0).log()  # as the camera clips
        rings = light.unflatten(0, (3, COARSE.directions))
        circle = _circle()
        slope = math.log(highlight.contrast) / (2.0 * highlight.width)
        middle_offset = 2.0 * (rings[1] * circle).mean(1) / slope
        levels = rings.mean(1)
        middle = 0.5 * (highlight.peak + highlight.surroundings)
        expected = torch.tensor([highlight.peak, middle, highlight.surroundings]).double().log()
        difference = (levels - expected) / COARSE.level_deviation
        aside = middle_offset / (
            COARSE.middle_deviation[0] + COARSE.middle_deviation[1] * highlight.width
        )
        return torch.cat([place_error, aside, difference])

    def residuals(self, parameters: Tensor) -> Tensor:
        """(residuals,) residuals at the parameters, in log radiance."""
        cells = self.cells
        difference = cells.differences(self.log_radiance(parameters, cells.image))
        # Of a lower bound, only a darker model has a residual.
        bounded = torch.where(difference > 0.0, difference * cells.above, difference)
        if self.whitening is not None:
            whole = (cells.above == 1.0).all(0)
            bounded = torch.where(whole, self.whitening @ difference, bounded)
        difference = bounded.flatten()
        if self.highlight is None:
            return difference
        return torch.cat([difference, COARSE.huber * self._evidence(parameters, self.highlight)])

    def quadratic(self, parameters: Tensor) -> tuple[Tensor, Tensor]:
        """(n, n) Gauss-Newton Hessian of the cost and (n,) its gradient, without brightening."""
        r = self.residuals(parameters)
        jacobian = _jacobian(self.residuals, parameters, r)
        weight = self.weight * COARSE.huber / r.abs().clamp_min(COARSE.huber)
        hessian = (jacobian * weight[:, None]).T @ jacobian + self.precision
        return hessian, jacobian.T @ (weight * r) + self.precision @ (parameters - self.prior)

    def falloff_evidence(self, parameters: Tensor) -> FalloffEvidence:
        """Likelihood of the falloff by Laplace's method at the parameters.

        The Hessian over a nat's cost is the posterior's precision; its Schur complement over all
        other unknowns is the falloff's. Less its prior's, that is the likelihood's.
        """
        hessian, gradient = self.quadratic(parameters)
        best = (parameters - torch.linalg.solve(hessian, gradient))[_FALLOFF]
        covariance = torch.linalg.inv(hessian / self.unit)
        posterior = torch.linalg.inv(covariance[_FALLOFF[:, None], _FALLOFF])
        prior = self.precision[_FALLOFF[:, None], _FALLOFF] / self.unit
        first, second = (posterior @ best - prior @ self.prior[_FALLOFF]).tolist()
        (own, both), (_, other) = (posterior - prior).tolist()
        return FalloffEvidence((first, second), (own, both, other))

    def brightening(self, parameters: Tensor) -> Tensor:
        """(n,) precision of the prior at 0 of negative falloff coefficients."""
        vignetting = Unknowns.of(parameters).vignetting
        precision_there = torch.where(vignetting < 0.0, self.unit / COARSE.brightening**2, 0.0)
        return replace(
            Unknowns.of(torch.zeros_like(parameters)), vignetting=precision_there
        ).vector()

    def cost(self, parameters: Tensor) -> float:
        """Cost at the parameters."""
        r = self.residuals(parameters).abs()
        huber = torch.where(
            r < COARSE.huber, 0.5 * r.square(), COARSE.huber * (r - 0.5 * COARSE.huber)
        )
        deviation = parameters - self.prior
        prior = 0.5 * deviation @ self.precision @ deviation
        prior = prior + 0.5 * (parameters.square() * self.brightening(parameters)).sum()
        return float((self.weight * huber).sum() + prior)


def _whitening(residuals: Tensor, weight: Tensor) -> Tensor:
    """(3, 3) whitening of the channels of residuals (3, n), which keeps their mean variance.

    The direction common to all channels is only scaled, so that an unfitted light does no harm.
    """
    share = weight / weight.sum()
    kept = residuals.clamp(-COARSE.texture_at_most, COARSE.texture_at_most)
    kept = kept - (kept * share).sum(1, keepdim=True)
    covariance = (kept * share) @ kept.T
    covariance = covariance + COARSE.colour_noise**2 * torch.eye(3, dtype=covariance.dtype)
    values, vectors = torch.linalg.eigh(covariance)
    scale = (covariance.trace() / 3.0).sqrt()
    return scale * (vectors * values.rsqrt()) @ vectors.T


def _image_grid(width: int, height: int) -> Tensor:
    """(2, h, w) image coordinates of cell centres, long side in [-1, 1]."""
    u = (torch.arange(width, dtype=torch.float64) + 0.5) / width * 2.0 - 1.0
    v = (1.0 - (torch.arange(height, dtype=torch.float64) + 0.5) / height * 2.0) * height / width
    return torch.stack([u.expand(height, width), v[:, None].expand(height, width)])


def _places(unknowns: Unknowns, distance: float) -> tuple[Tensor, Tensor, Tensor]:
    """(3,) each, in the camera frame: the plane's normal, places of camera and flash."""
    normal = rotation(*unknowns.tilt.unbind())[:, 2]
    camera = _numbers(0.0, 0.0, distance)
    return normal, camera, camera + F.pad(unknowns.offset, (0, 1))


def _log_radiance(
    parameters: Tensor, image: Tensor, distance: float, *, conductor: bool = False
) -> Tensor:
    """(3, n) log radiance of the uniform material at image coordinates (2, n)."""
    unknowns = Unknowns.of(parameters)
    normal, camera, flash = _places(unknowns, distance)
    image = image[:, None]
    # Points where the rays meet the tilted plane.
    ray = torch.cat([image, torch.full_like(image[:1], -distance)])
    along = -(normal[2] * distance) / torch.tensordot(normal, ray, dims=1)
    points = camera[:, None, None] + along * ray
    light = FlashLight.between(points, camera, flash, unknowns.flash.exp()[:, None, None])
    incidence = light.onto(normal[:, None, None].expand_as(points), exact=True)
    colour = unknowns.albedo.exp()[:, None, None]
    radiance = incidence.diffuse(colour * (COARSE.black if conductor else 1.0))
    specular = colour if conductor else unknowns.specular.exp()[:, None, None]
    for share, roughness in unknowns.lobes:
        radiance = radiance + share * incidence.specular(specular, roughness[:, None, None])
    return ((radiance + _DARKEST).log() + log_vignette(image, *unknowns.vignetting)).flatten(1)


def _distinct(fits: Sequence[Tensor]) -> list[Tensor]:
    """Parameters, the best first, without those of nearly the same roughness as better ones."""
    kept: list[Tensor] = []
    for candidate in fits:
        others = [Unknowns.of(one).roughness for one in kept]
        if all(
            float(abs(Unknowns.of(candidate).roughness - one)) > COARSE.distinct for one in others
        ):
            kept.append(candidate)
    return kept


def _matte(candidate: Tensor) -> Tensor:
    """Parameters with roughness set near 1, for a matte starting point."""
    unknowns = Unknowns.of(candidate)
    return replace(unknowns, roughness=torch.full_like(unknowns.roughness, _MATTE)).vector()


def _mattest(fits: Sequence[tuple[float, Tensor]]) -> Tensor:
    """The roughest among fits (cost, parameters) of nearly equal cost, so that no highlight is
    invented in clipped areas.
    """
    least = min(cost for cost, _ in fits)
    alike = [candidate for cost, candidate in fits if cost <= least + 0.5 * COARSE.alike**2]
    return max(alike, key=lambda candidate: float(Unknowns.of(candidate).roughness))


def _parted(single: Tensor) -> Tensor:
    """Parameters of two lobes, a little narrower and wider than one."""
    one = Unknowns.of(single)
    return replace(one, roughness=one.roughness - 0.4, **_PARTED_MEAN).vector()


def _starts(
    observed: Tensor, prior: _Prior, highlight: Highlight | None, distance: float
) -> Iterable[Tensor]:
    """Starting points whose brightness and hue already fit the photograph's median.

    Radiance there is about albedo / pi intensity / distance^2; a conductor's is darker, away from
    its highlight.
    """
    mean = prior.mean
    median = observed.median(dim=1).values
    brightness = median.mean()
    intensity = brightness - mean.albedo[:1] + math.log(math.pi) + 2.0
    logits, places = list(_STARTS), [mean]
    if highlight is not None:
        alpha = min(highlight.width / (_HALF_GGX * distance), 0.6)
        means = math.sqrt(alpha)
        logits = [_STARTS[0]]
        logits += [math.log(share * means / (1.0 - share * means)) for share in _WIDTHS]
        u, v = highlight.centre
        # The centre is determined by the flash's offset or by the tilt: start from both.
        tilt_x, tilt_y = mean.tilt.tolist()
        across, up = u + distance * math.tan(tilt_y), v - distance * math.tan(tilt_x)
        shifted = replace(mean, offset=_numbers(2.0 * across, 2.0 * up))
        turned = replace(mean, tilt=_numbers(v / distance, -u / distance))
        places = [shifted] if prior.at_lens else [shifted, turned]
    for place in places:
        for logit in logits:
            yield replace(
                place,
                albedo=mean.albedo + (median - brightness),
                roughness=_numbers(logit),
                intensity=intensity + (1.5 if prior.conductor else 0.0),
            ).vector()


def _levenberg_marquardt(problem: _Problem, start: Tensor, iterations: int) -> tuple[float, Tensor]:
    """Minimise a problem's cost; returns (cost, parameters)."""
    parameters, damping = start.clone(), 1e-2
    cost = problem.cost(parameters)
    for _ in range(iterations):
        normal, gradient = problem.quadratic(parameters)
        extra = problem.brightening(parameters)
        normal, gradient = normal + torch.diag(extra), gradient + extra * parameters
        candidate, new = parameters, math.inf
        while not new < cost and damping < 1e6:
            damped = normal + damping * torch.diag(normal.diagonal())
            candidate = parameters - torch.linalg.solve(damped, gradient).clamp(-1.0, 1.0)
            new = problem.cost(candidate)
            damping *= 4.0
        if not new < cost:
            break
        converged = cost - new < 1e-5 * cost
        parameters, cost, damping = candidate, new, max(damping / 16.0, 1e-6)
        if converged:
            break
    return cost, parameters


def _jacobian(residuals: Callable[[Tensor], Tensor], parameters: Tensor, here: Tensor) -> Tensor:
    """(residuals, parameters) Jacobian by forward differences from the residuals `here`.

    Accurate to 1e-5 in float64, enough for the accepted steps. Faster than `torch.func.jacfwd` for
    few parameters, which also takes two seconds to import PyTorch's compiler.
    """
    steps = _STEP * torch.eye(len(parameters), dtype=parameters.dtype)
    return (torch.vmap(residuals)(parameters + steps) - here).T / _STEP
