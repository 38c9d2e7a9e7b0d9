"""Per-texel parameters, and their Gauss-Newton step on the log radiance of all photographs.

PARAMETERS = 7: log diffuse albedo (3), log F0, logit roughness, slopes along x and y.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.cook_torrance import (
    ALBEDO,
    ALBEDO_LIMITS,
    F0,
    F0_LIMITS,
    ROUGHNESS_LIMITS,
    SINGLE_ROUGHNESS,
    Reflectance,
    SurfaceParameters,
)
from matcap.brdf.maps import (
    MapSet,
    normals_from_height,
    normals_from_slopes,
)
from matcap.capture.multiview.ambient_light import AmbientLight, evenly_lit
from matcap.capture.multiview.views import ResampledView, SharedLight, light_at
from matcap.flash.geometry import (
    OWN,
    Extent,
    plane_points,
)
from matcap.flash.light import (
    DifferentiableLight,
    linearised,
    strips,
)

# Parameters of a texel besides ALBEDO, F0 and ROUGH, their number, and the channels of each part.
GLOSS, SLOPES = slice(3, 5), slice(5, 7)
PARAMETERS, _PARTS = 7, (3, 1, 1, 2)
# Slopes among the parameters other than albedo.
OTHER_SLOPES, _SLOPE_X, _SLOPE_Y = slice(2, 4), 2, 3

# Of the multi-view solution; docs/notes/several.md.
_ROBUST = 0.25  # s of the weights 1 / (1 + (r / s)^2)^2 of residuals r of log radiance
# Standard deviation of log radiance in one channel of one photograph, model error included.
_NOISE = 0.02
# Least prior standard deviation of log albedo.
_ALBEDO = 0.25
# Prior standard deviation of log F0 and logit roughness. They are constant in a material class, so
# it is small: wider ones scatter from texel to texel (docs/notes/several.md).
_GLOSS = 0.07
_STEEPEST = 3.0  # largest slope
# Levenberg-Marquardt: share of a parameter's precision added to the diagonal. Less overshoots;
# more leaves the trade-off of albedo and slope at its initial value.
_DAMPING = 0.005
ROWS = 48  # of texels solved at a time; memory is proportional


@dataclass(frozen=True)
class Stepped:
    """Result of a Gauss-Newton step."""

    parameters: Tensor
    """(PARAMETERS, H, W)."""
    precision: Tensor
    """(PARAMETERS, H, W) diagonal of the photographs' J^T W J, prior excluded."""
    relief: Tensor
    """(3, H, W) precision of slopes: xx, yy and xy of the posterior, all other parameters
    eliminated."""
    changes: Tensor
    """(photographs, some parameters, H, W) change when each photograph is left out: the jackknife
    [efron1982]. Empty unless requested."""

    @staticmethod
    def none(parameters: Tensor) -> Stepped:
        """Before any step: precision 0, relief that of independent unit slopes."""
        one = torch.ones_like(parameters[:1])
        relief = torch.cat([one, one, 0.0 * one])
        return Stepped(parameters, torch.zeros_like(parameters), relief, parameters.new_zeros(0))


@dataclass(frozen=True)
class Estimate:
    """Maps of the exemplar and their standard deviations."""

    maps: MapSet
    """Maps of the exemplar."""
    log_error: Tensor
    """(4, H, W) log of the standard deviations of log albedo, log F0, logit roughness and slope."""

    def resized(self, size: tuple[int, int], extent: Extent = OWN) -> Estimate:
        """Area average on a coarser grid of `size` = (rows, columns) texels over an extent."""
        maps, log_error = (
            F.interpolate(each[None], size=size, mode="area")[0]
            for each in (self.maps.stacked(), self.log_error)
        )
        return Estimate(MapSet.from_stacked(maps, extent.texel(size[1])), log_error)

    def with_most_error(self, log_error: Tensor) -> Estimate:
        """With logs of standard deviations of at most `log_error` (4,)."""
        return replace(self, log_error=torch.minimum(self.log_error, log_error[:, None, None]))


@dataclass(frozen=True)
class ParameterPrior:
    """Independent Gaussian prior of each parameter of each texel."""

    mean: Tensor
    deviation: Tensor
    """(PARAMETERS, ...) mean and standard deviation."""

    @staticmethod
    def of(estimate: Estimate) -> ParameterPrior:
        """Prior from the network's prediction, with least deviations."""
        albedo, *_, slope = estimate.log_error.clamp(-8.0, 2.0).exp().split(1)
        gloss = torch.full_like(albedo, _GLOSS).expand(2, -1, -1)
        albedo = albedo.clamp_min(_ALBEDO).expand(3, -1, -1)
        deviation = torch.cat([albedo, gloss, slope.expand(2, -1, -1)])
        return ParameterPrior(parameters_of(estimate.maps), deviation)

    @property
    def precision(self) -> Tensor:
        """(PARAMETERS, ...) 1 / deviation^2."""
        return self.deviation.square().reciprocal()

    def with_gloss_of(self, light: SharedLight) -> ParameterPrior:
        """With SharedLight.gloss added to the means of log F0 and logit roughness."""
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
    surface = SurfaceParameters.of(replace(maps, specular=maps.specular.mean(-3, keepdim=True)))
    slopes = slopes_of(maps.height, maps.texel_size)
    return torch.cat([surface.diffuse, surface.specular, surface.roughness, slopes]).float()


def limited(parameters: Tensor) -> Tensor:
    """Parameters (PARAMETERS, H, W) within the limits of reflectance and slopes.

    Lobes of fits do not change below SINGLE_ROUGHNESS.
    """
    albedo, f0 = torch.tensor([ALBEDO_LIMITS, F0_LIMITS]).log()
    roughness = torch.tensor([SINGLE_ROUGHNESS, ROUGHNESS_LIMITS[1]]).logit()
    steep = torch.tensor([-_STEEPEST, _STEEPEST])
    low, high = torch.stack([albedo, albedo, albedo, f0, roughness, steep, steep], dim=1)
    return parameters.clamp(low[:, None, None], high[:, None, None])


def maps_of(parameters: Tensor, height: Tensor, texel_size: float) -> MapSet:
    """Maps of parameters (PARAMETERS, H, W) and a height (1, H, W) that matches their slopes."""
    log_albedo, log_f0, logit_roughness, _ = parameters.split(_PARTS)
    surface = SurfaceParameters(log_albedo, log_f0, logit_roughness, height / texel_size)
    return surface.maps(texel_size)


def slopes_of(height: Tensor, texel_size: float) -> Tensor:
    """(2, H, W) slopes of a height (1, H, W), plane units, by central differences."""
    normal = normals_from_height(height, texel_size)
    return -normal[:2] / normal[2:]


def points_of(
    size: torch.Size | tuple[int, ...], rows: slice = slice(None), extent: Extent = OWN
) -> Tensor:
    """(3, h, w) plane points of a grid (height, width), or of some rows of it."""
    height, width = size
    top, bottom, _ = rows.indices(height)
    points = plane_points(0, top, width, bottom - top, (width, height), dtype=torch.float32)
    return extent.placed(points)


def log_rendered(parameters: Tensor, lights: Sequence[DifferentiableLight]) -> list[Tensor]:
    """Log radiance (3, h, w) of parameters (PARAMETERS, h, w) in each light."""
    normal, surface = _surface(parameters)
    return [light.onto(normal).log_radiance(surface)[0] for light in lights]


def _surface(parameters: Tensor) -> tuple[Tensor, Reflectance]:
    """Normals and reflectance of parameters (PARAMETERS, h, w)."""
    log_albedo, log_f0, logit_roughness, slopes = parameters.split(_PARTS)
    normal = normals_from_slopes(*slopes.split(1))
    return normal, Reflectance(log_albedo.exp(), log_f0.exp(), torch.sigmoid(logit_roughness))


def under_fitted_ambient(
    views: Sequence[ResampledView], parameters: Tensor, light: SharedLight
) -> list[ResampledView]:
    """Replace the ambient photograph's low frequencies by those of the rendered parameters."""

    def even(view: ResampledView) -> ResampledView:
        (rendered,) = log_rendered(parameters, [AmbientLight(light.ambient)])
        return replace(view, log=evenly_lit(view.log, view.seen, rendered))

    return [view if view.flash else even(view) for view in views]


def weights(residual: Tensor, seen: Tensor, noise: float) -> Tensor:
    """Weights of residuals r of log radiance: 1 / (1 + (r / s)^2)^2 / variance [geman1985]."""
    kept = 1.0 / (1.0 + (residual / _ROBUST).square()).square()
    return seen * kept / (_NOISE**2 + noise**2)


def stepped(
    views: Sequence[ResampledView],
    parameters: Tensor,
    prior: ParameterPrior,
    light: SharedLight,
    *,
    slopes: bool = True,
    changed: slice | None = None,
) -> Stepped:
    """A Gauss-Newton step at every texel, and the jackknife changes of some parameters.

    Args:
        views: photographs on the grid.
        parameters: (PARAMETERS, H, W) current estimate.
        prior: of the parameters.
        light: of all photographs.
        slopes: whether slopes move; if not, their precision is 0.
        changed: parameters whose changes without each photograph are computed; None for none.
    """
    moved, precision = parameters.clone(), torch.zeros_like(parameters)
    relief = torch.zeros(3, *parameters.shape[1:])
    changes = torch.zeros(len(views) if changed else 0, *parameters[changed or slice(0)].shape)
    for rows in strips(parameters.shape[1], ROWS):
        part = slice(PARAMETERS if slopes else SLOPES.start), rows
        of_each = _normal_equations(views, rows, parameters[:, rows], light, slopes=slopes)
        whole = sum(of_each[1:], of_each[0])
        current = parameters[part], prior.mean[part], prior.deviation[part]
        moved[part], precision[part], factor = whole.solved(*current)
        if slopes:
            relief[:, rows] = _slope_precision(factor).reshape(relief[:, rows].shape)
        for change, own in zip(changes, of_each, strict=bool(changed)):
            change[:, rows] = ((whole - own).solved(*current)[0] - moved[part])[changed]
    return Stepped(limited(moved), precision, relief, changes)


@dataclass(frozen=True)
class _NormalEquations:
    """Normal equations J^T W J d = J^T W r of N texels, r being residuals of log radiance.

    Albedo of a channel changes the radiance of that channel only, so the equations of the three
    albedos a are coupled to those of the m other parameters o, but not to each other:

        D a + B o = g,    B^T a + C o = h,    D diagonal.
    """

    albedo: Tensor
    """(3, m + 2, N) rows of albedo: diagonal of D, then B, then g."""
    others: Tensor
    """(m + 1, m, N) lower triangle of C, and h as the last row."""

    def __add__(self, other: _NormalEquations) -> _NormalEquations:
        return _NormalEquations(self.albedo + other.albedo, self.others + other.others)

    def __sub__(self, other: _NormalEquations) -> _NormalEquations:
        return _NormalEquations(self.albedo - other.albedo, self.others - other.others)

    @staticmethod
    def of(residual: Tensor, weight: Tensor, share: Tensor, by_others: Tensor) -> _NormalEquations:
        """Equations of one photograph.

        Args:
            residual, weight: (3, N) of log radiance.
            share: (3, N) derivative by albedo, as of `derivatives`.
            by_others: (m, 3, N) derivatives by the others.
        """
        m, texels = len(by_others), residual.shape[-1]
        albedo, others = torch.zeros(3, m + 2, texels), torch.zeros(m + 1, m, texels)
        torch.mul(share, weight, out=albedo[:, 0])
        torch.mul(by_others, albedo[:, 0], out=albedo[:, 1:-1].movedim(0, 1))
        torch.mul(residual, albedo[:, 0], out=albedo[:, -1])
        albedo[:, 0] *= share
        weighted = by_others * weight
        for number in range(m):
            others[number:-1, number] = (weighted[number] * by_others[number:]).sum(1)
        others[-1] = (weighted * residual).sum(1)
        return _NormalEquations(albedo, others)

    def solved(
        self, parameters: Tensor, mean: Tensor, deviation: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Parameters after a damped step with a Gaussian prior, albedo eliminated.

        With prior and damping in D, C, g and h,

            (C - B^T D^-1 B) o = h - B^T D^-1 g,    a = D^-1 (g - B o).

        Args:
            parameters, mean, deviation: (n, h, w) current and prior.

        Returns:
            (n, h, w) parameters and precision, prior excluded; and the Cholesky factor (m, m, N)
            of the others' equations.
        """
        shape = parameters.shape
        precision = deviation.flatten(1).square().reciprocal()
        pull = precision * (mean - parameters).flatten(1)
        measured = torch.cat([self.albedo[:, 0], self.others.diagonal().T])
        albedo, others = self.albedo.clone(), self.others.clone()
        damped = precision + _DAMPING * measured
        albedo[:, 0] += damped[ALBEDO]
        albedo[:, -1] += pull[ALBEDO]
        others.diagonal().T.add_(damped[F0:])
        others[-1] += pull[F0:]
        albedo[:, 1:] *= albedo[:, :1].rsqrt()
        for number in range(others.shape[1]):
            others[number:, number] -= (albedo[:, 1 + number :] * albedo[:, 1 + number, None]).sum(
                0
            )
        of_others = solved_in_place(others)[:, 0]
        of_albedo = albedo[:, -1] - (albedo[:, 1:-1] * of_others).sum(1)
        step = torch.cat([of_albedo * albedo[:, 0].rsqrt(), of_others])
        step = step.nan_to_num(0.0).clamp(-0.7, 0.7)
        return parameters + step.reshape(shape), measured.reshape(shape), others[:-1]


def _slope_precision(factor: Tensor) -> Tensor:
    """(3, N) precision of slopes, xx, yy and xy, the other parameters eliminated.

    It is L L^T, L being the block of slopes of the Cholesky factor (4, 4, N), as they are last.
    """
    xx, yx, yy = factor[_SLOPE_X, _SLOPE_X], factor[_SLOPE_Y, _SLOPE_X], factor[_SLOPE_Y, _SLOPE_Y]
    return torch.stack([xx.square(), yx.square() + yy.square(), xx * yx]).nan_to_num(0.0)


def _normal_equations(
    views: Sequence[ResampledView],
    rows: slice,
    parameters: Tensor,
    light: SharedLight,
    *,
    slopes: bool,
) -> list[_NormalEquations]:
    """Normal equations of each photograph at some rows, without slopes if these do not move."""
    points = points_of(views[0].log.shape[-2:], rows, views[0].extent)
    seen = [view.seen[:, rows] for view in views]
    lights = (light_at(k, view, light, points) for k, view in enumerate(views) if seen[k].any())
    shaded = derivatives(parameters, lights)
    m, texels = (PARAMETERS if slopes else SLOPES.start) - F0, parameters[0].numel()
    nothing = _NormalEquations(torch.zeros(3, m + 2, texels), torch.zeros(m + 1, m, texels))
    equations = []
    for view, mask in zip(views, seen, strict=True):
        if not mask.any():
            equations.append(nothing)
            continue
        log, share, by_others = next(shaded)
        residual = view.log[:, rows] - log
        weight = weights(residual, mask, view.noise).flatten(1)
        equations.append(_NormalEquations.of(residual.flatten(1), weight, share, by_others[:m]))
    return equations


def derivatives(
    parameters: Tensor, lights: Iterable[DifferentiableLight]
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """In each light log radiance (3, h, w) and its derivatives by the parameters, texels in a row.

    These are by the albedo of the channel (3, h * w), and by the other four (4, 3, h * w), as of
    flash.light.linearised.
    """
    normal, surface = _surface(parameters)
    for light in lights:
        log, share, by_others = linearised(light, normal, surface)
        yield log, share.flatten(1), by_others.flatten(2)


def jacobian(share: Tensor, by_others: Tensor) -> Tensor:
    """(PARAMETERS, 3, N) d log L by all parameters, from those of `derivatives`."""
    return torch.cat([torch.diag_embed(share.T).movedim(0, -1), by_others])


def solved_in_place(system: Tensor) -> Tensor:
    """Solutions (n, k, N) of N small systems side by side, which become their Cholesky factors.

    A third of the time of LAPACK's, which solves one system after the other. NaN where a system is
    not positive definite.

    Args:
        system: (n + k, n, N) lower triangles, and k right-hand sides as the last rows.
    """
    count = system.shape[1]
    for k in range(count):
        system[k:, k] *= system[k, k].rsqrt()
        for j in range(k + 1, count):
            system[j:, j] -= system[j:, k] * system[j, k]
    solution = system[count:].movedim(0, 1).clone()
    for k in reversed(range(count)):
        solution[k] /= system[k, k]
        solution[:k] -= system[k, :k, None] * solution[k]
    return solution
