"""Per-texel parameters, and their Gauss-Newton step on the log radiance of all photographs.

PARAMETERS = 7: log diffuse albedo (3), log F0, logit roughness, slopes along x and y.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.brdf.normals import normals_from_height, normals_from_slopes
from matcap.brdf.parameters import ALBEDO, F0, ROUGH
from matcap.capture.together.ambient_light import AmbientLight, evenly_lit
from matcap.capture.together.views import PieceView, SetLight, light_at, logarithm, radiance
from matcap.flash.extent import OWN, Extent
from matcap.flash.geometry import plane_points
from matcap.flash.light import FlashLight, strips

# Besides ALBEDO, F0 and ROUGH: slopes, and both of a kind.
ACROSS, UP, GLOSS, SLOPES = 5, 6, slice(3, 5), slice(5, 7)
PARAMETERS = 7


# Of the multi-view solution; docs/notes/several.md.
_ROBUST = 0.25  # s of the weights 1 / (1 + (r / s)^2)^2 of residuals r of log radiance
# Standard deviation of log radiance in one channel of one photograph, model error included.
_NOISE = 0.02
# Least standard deviation of the prior of log albedo, and of log F0 and logit roughness. Smaller
# keeps closer to the network's prediction.
_ALBEDO, _GLOSS = 0.25, 0.2
_STEEPEST = 3.0  # limit of slopes
STEP = 0.02  # of finite differences, parameter units
# Levenberg-Marquardt: share of a parameter's precision added to the diagonal. Less overshoots;
# more leaves the trade-off of albedo and slope at its initial value.
_DAMPING = 0.005
ROWS = 48  # of texels solved at a time; memory is proportional


@dataclass(frozen=True)
class Stepped:
    """Result of a Gauss-Newton step.

    Attributes:
        parameters: (PARAMETERS, H, W).
        precision: (PARAMETERS, H, W) diagonal of the photographs' J^T W J, prior excluded.
        relief: (3, H, W) precision of slopes: xx, yy and xy of the posterior, all other parameters
            eliminated.
        changes: (photographs, PARAMETERS, H, W) change when each photograph is left out: the
            jackknife [efron1982]. Empty unless requested.
    """

    parameters: Tensor
    precision: Tensor
    relief: Tensor
    changes: Tensor

    @staticmethod
    def none(parameters: Tensor) -> Stepped:
        """Before any step: precision 0, relief that of independent unit slopes."""
        one = torch.ones_like(parameters[:1])
        relief = torch.cat([one, one, 0.0 * one])
        return Stepped(parameters, torch.zeros_like(parameters), relief, parameters.new_zeros(0))


@dataclass(frozen=True)
class Estimate:
    """Maps of the exemplar and their standard deviations.

    Attributes:
        maps: of the exemplar.
        log_error: (4, H, W) log of the standard deviations of log albedo, log F0, logit roughness
            and slope.
    """

    maps: MapSet
    log_error: Tensor

    def resized(self, size: tuple[int, int], extent: Extent = OWN) -> Estimate:
        """Area average on a coarser grid of `size` = (rows, columns) texels over an extent."""
        maps, log_error = (
            F.interpolate(each[None], size=size, mode="area")[0]
            for each in (self.maps.stacked(), self.log_error)
        )
        return Estimate(MapSet.from_stacked(maps, extent.texel(size[1])), log_error)


@dataclass(frozen=True)
class ParameterPrior:
    """Independent Gaussian prior of each parameter of each texel.

    Attributes:
        mean, deviation: (PARAMETERS, ...) mean and standard deviation.
    """

    mean: Tensor
    deviation: Tensor

    @staticmethod
    def of(estimate: Estimate) -> ParameterPrior:
        """Prior from the network's prediction, with least deviations."""
        off = estimate.log_error.clamp(-8.0, 2.0).exp()
        albedo = off[:1].clamp_min(_ALBEDO).expand(3, -1, -1)
        f0, rough, slope = off[1:].split(1)
        gloss = (each.clamp_min(_GLOSS) for each in (f0, rough))
        deviation = torch.cat([albedo, *gloss, slope.expand(2, -1, -1)])
        return ParameterPrior(parameters_of(estimate.maps), deviation)

    @property
    def precision(self) -> Tensor:
        """(PARAMETERS, ...) 1 / deviation^2."""
        return self.deviation.square().reciprocal()

    def with_gloss_of(self, light: SetLight) -> ParameterPrior:
        """With SetLight.gloss added to the means of log F0 and logit roughness."""
        mean = self.mean.clone()
        mean[GLOSS] += light.gloss[:, None, None]
        return ParameterPrior(mean, self.deviation)

    def with_least_slope(self, slope: float) -> ParameterPrior:
        """With standard deviations of slopes of at least `slope`."""
        deviation = self.deviation.clone()
        deviation[SLOPES] = deviation[SLOPES].clamp_min(slope)
        return ParameterPrior(self.mean, deviation)


def parameters_of(maps: MapSet) -> Tensor:
    """(PARAMETERS, H, W) parameters of maps; F0 is averaged over its channels."""
    slopes = slopes_of(maps.height, maps.texel_size)
    return torch.cat(
        [
            maps.diffuse.clamp(1e-3, 0.98).log(),
            maps.specular.mean(-3, keepdim=True).clamp(5e-3, 0.98).log(),
            maps.roughness.clamp(0.03, 0.98).logit(),
            slopes,
        ]
    ).float()


def maps_of(parameters: Tensor, height: Tensor, texel_size: float) -> MapSet:
    """Maps of parameters (PARAMETERS, H, W) and a height (1, H, W) that matches their slopes."""
    return MapSet(
        diffuse=parameters[ALBEDO].exp().clamp(1e-3, 0.98),
        specular=parameters[F0 : F0 + 1].exp().clamp(5e-3, 0.98),
        roughness=torch.sigmoid(parameters[ROUGH : ROUGH + 1]).clamp(0.03, 0.98),
        height=height,
        texel_size=texel_size,
    )


def by_map(parameters: Tensor) -> Tensor:
    """(PARAMETERS, H, W) to (4, H, W): means over the albedo channels, and over both slopes."""
    albedo, slope = parameters[ALBEDO].mean(0), parameters[SLOPES].mean(0)
    return torch.stack([albedo, parameters[F0], parameters[ROUGH], slope])


def slopes_of(height: Tensor, texel_size: float) -> Tensor:
    """(2, H, W) slopes of a height (1, H, W), plane units, by central differences."""
    normal = normals_from_height(height, texel_size)
    return -normal[:2] / normal[2:]


def points_of(
    size: torch.Size | tuple[int, ...], rows: slice | None = None, extent: Extent = OWN
) -> Tensor:
    """(3, h, w) plane points of a grid, or of some rows of it."""
    height, width = size
    rows = rows or slice(0, height)
    points = plane_points(
        0, rows.start, width, rows.stop - rows.start, (width, height), dtype=torch.float32
    )
    return extent.placed(points)


def rendered(parameters: Tensor, lights: Sequence[FlashLight | AmbientLight]) -> list[Tensor]:
    """Radiance (3, h, w) of parameters (PARAMETERS, h, w) in each light."""
    normal = normals_from_slopes(*parameters[SLOPES].split(1))
    matte, f0 = parameters[ALBEDO].exp(), parameters[F0 : F0 + 1].exp()
    rough = torch.sigmoid(parameters[ROUGH : ROUGH + 1])
    return [radiance(light, matte, f0, rough, normal) for light in lights]


def under_fitted_ambient(
    views: Sequence[PieceView], parameters: Tensor, light: SetLight
) -> list[PieceView]:
    """Replace the ambient photograph's low frequencies by those of the rendered parameters."""

    def even(view: PieceView) -> PieceView:
        shown = rendered(parameters, [AmbientLight(light.lean)])[0].log()
        return replace(view, log=evenly_lit(view.log, view.seen, shown))

    return [view if view.ambient is None else even(view) for view in views]


def weights(residual: Tensor, seen: Tensor, noise: float) -> Tensor:
    """Weights of residuals r of log radiance: 1 / (1 + (r / s)^2)^2 / variance [geman1985]."""
    kept = 1.0 / (1.0 + (residual / _ROBUST).square()).square()
    return seen * kept / (_NOISE**2 + noise**2)


def stepped(
    views: Sequence[PieceView],
    parameters: Tensor,
    prior: ParameterPrior,
    light: SetLight,
    *,
    without_each: bool = False,
) -> Stepped:
    """A Gauss-Newton step at every texel; with `without_each` also the jackknife changes.

    Args:
        views: photographs on the grid.
        parameters: (PARAMETERS, H, W) current estimate.
        prior: of the parameters.
        light: of all photographs.
        without_each: repeat the step without each photograph.
    """
    moved, precision = torch.empty_like(parameters), torch.empty_like(parameters)
    relief = torch.empty(3, *parameters.shape[1:])
    changes = torch.zeros(len(views) * without_each, *parameters.shape)
    for rows in strips(parameters.shape[1], ROWS):
        part = slice(None), rows
        points = points_of(parameters.shape[-2:], rows, views[0].extent)
        of_each = [
            _system(index, view, rows, parameters[part], light, points)
            for index, view in enumerate(views)
        ]
        here = parameters[part], ParameterPrior(prior.mean[part], prior.deviation[part])
        moved[part], precision[part], relief[part] = _solved(of_each, *here, _DAMPING)
        for k, change in enumerate(changes):
            others = of_each[:k] + of_each[k + 1 :]
            change[part] = _solved(others, *here, _DAMPING)[0] - moved[part]
    steep = _STEEPEST
    moved[SLOPES] = moved[SLOPES].clamp(-steep, steep)
    moved[ALBEDO] = moved[ALBEDO].clamp(math.log(1e-3), math.log(0.98))
    moved[F0] = moved[F0].clamp(math.log(5e-3), math.log(0.98))
    moved[ROUGH] = moved[ROUGH].clamp(-3.5, 3.9)
    return Stepped(moved, precision, relief, changes)


def _system(
    index: int,
    view: PieceView,
    rows: slice,
    parameters: Tensor,
    light: SetLight,
    points: Tensor,
) -> tuple[Tensor, Tensor]:
    """Normal equations (7, 7, N) and right-hand sides (7, N) of some rows of a photograph."""
    count = parameters[0].numel()
    normal, gradient = torch.zeros(PARAMETERS, PARAMETERS, count), torch.zeros(PARAMETERS, count)
    seen = view.seen[:, rows]
    if seen.any():
        log, shown = derivatives(parameters, light_at(index, view, light, points), STEP)
        residual = view.log[:, rows] - log
        weight = weights(residual, seen, view.noise).flatten(1)
        weighted = shown * weight
        # Albedo of a channel changes only that channel's radiance.
        for channel in range(3):
            own = weighted[channel, channel]
            normal[channel, channel] = own * shown[channel, channel]
            normal[3:, channel] = own * shown[3:, channel]
        for number in range(3, PARAMETERS):
            normal[number:, number] = (weighted[number] * shown[number:]).sum(1)
        gradient = (weighted * residual.flatten(1)).sum(1)
    for number in range(PARAMETERS):
        normal[number, number + 1 :] = normal[number + 1 :, number]
    return normal, gradient


def derivatives(
    parameters: Tensor, light: FlashLight | AmbientLight, step: float
) -> tuple[Tensor, Tensor]:
    """Log radiance (3, h, w), and its Jacobian (PARAMETERS, 3, h * w).

    d log L / d log albedo is the diffuse share of the radiance; the others are forward differences.

    Args:
        parameters: (PARAMETERS, h, w).
        light: incident at those texels.
        step: of the differences, parameter units.
    """
    matte, f0 = parameters[ALBEDO].exp(), parameters[F0 : F0 + 1].exp()
    rough = torch.sigmoid(parameters[ROUGH : ROUGH + 1])
    x, y = parameters[SLOPES].split(1)
    incidence = light.onto(normals_from_slopes(x, y))
    diffuse = incidence.diffuse(matte)
    log = logarithm(diffuse + incidence.specular(f0, rough))
    rougher = torch.sigmoid(parameters[ROUGH : ROUGH + 1] + step)
    moved = [
        diffuse + incidence.specular(f0 * math.exp(step), rough),
        diffuse + incidence.specular(f0, rougher),
        light.onto(normals_from_slopes(x + step, y)).radiance(matte, f0, rough),
        light.onto(normals_from_slopes(x, y + step)).radiance(matte, f0, rough),
    ]
    shown = torch.zeros(PARAMETERS, 3, log[0].numel())
    for number, each in enumerate(moved, start=F0):
        shown[number] = ((logarithm(each) - log) / step).flatten(1)
    share = (diffuse / log.exp()).flatten(1)
    for channel in range(3):
        shown[channel, channel] = share[channel]
    return log, shown


def _solved(
    systems: Sequence[tuple[Tensor, Tensor]],
    parameters: Tensor,
    prior: ParameterPrior,
    damping: float,
) -> tuple[Tensor, Tensor, Tensor]:
    """Parameters, precision and relief as in Stepped, of some rows, from summed `systems`."""
    shape, count = parameters.shape, parameters[0].numel()
    normal = sum((each for each, _ in systems), torch.zeros(PARAMETERS, PARAMETERS, count))
    gradient = sum((each for _, each in systems), torch.zeros(PARAMETERS, count))
    here, expected = parameters.flatten(1), prior.mean.flatten(1)
    prior_precision = prior.deviation.flatten(1).square().reciprocal()
    measured_precision = normal.diagonal().T.clone()
    normal.diagonal().T.add_(prior_precision + damping * measured_precision)
    step, factor = _cholesky(normal, gradient + prior_precision * (expected - here))
    step = step.nan_to_num(0.0).clamp(-0.7, 0.7)
    # The factor's last block is that of the slopes' precision with other parameters eliminated.
    first, across, second = factor[ACROSS, ACROSS], factor[UP, ACROSS], factor[UP, UP]
    relief = torch.stack([first.square(), across.square() + second.square(), first * across])
    return (
        (here + step).reshape(shape),
        measured_precision.reshape(shape),
        relief.nan_to_num(0.0).reshape(3, *shape[1:]),
    )


def _cholesky(normal: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
    """Solutions (n, N) and Cholesky factors (n + 1, n, N) of N small systems side by side.

    A third of the time of LAPACK's, which solves one system after the other. NaN where a system is
    not positive definite. The factors' last row is that of the right-hand side.

    Args:
        normal: (n, n, N) symmetric.
        right: (n, N).
    """
    factor, count = torch.cat([normal, right[None]]), len(right)
    for k in range(count):
        factor[k:, k] *= factor[k, k].rsqrt()
        for j in range(k + 1, count):
            factor[j:, j] -= factor[j:, k] * factor[j, k]
    solution = factor[count].clone()
    for k in reversed(range(count)):
        solution[k] /= factor[k, k]
        solution[:k] -= factor[k, :k] * solution[k]
    return solution, factor
