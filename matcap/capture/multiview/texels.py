"""Per-texel parameters, and their Gauss-Newton step on the log radiance of all photographs.

PARAMETERS = 7: log diffuse albedo (3), log F0 (of a colour, its mean over channels), logit
roughness, slopes along x and y. Rows beyond are the log specular tint (3) of a coloured F0, which
no step changes: it belongs to the texel's material (basis.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
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
from matcap.brdf.maps import MapSet, normals_from_height, normals_from_slopes
from matcap.capture.multiview.views import (
    AmbientLight,
    Resampled,
    ResampledView,
    SharedLight,
    evenly_lit,
    light_at,
)
from matcap.flash.geometry import OWN, Extent, points_of
from matcap.flash.light import DifferentiableLight, linearised, strips

# Parameters of a texel besides ALBEDO, F0 and ROUGH, their number, and the channels of each part.
GLOSS, SLOPES = slice(3, 5), slice(5, 7)
PARAMETERS, _PARTS = 7, (3, 1, 1, 2)
TINT = slice(7, 10)
# Log specular tint by the two parameters of a hue: red against blue, and green against both.
HUES = torch.tensor([[1.0, 0.0, -1.0], [0.5, -1.0, 0.5]])
# Slopes among the parameters other than albedo.
OTHER_SLOPES = slice(2, 4)

# Of the multi-view solution; docs/notes/several.md.
_ROBUST = 0.25  # s of the weights 1 / (1 + (r / s)^2)^2 of residuals r of log radiance
# Least prior standard deviation of log albedo.
_ALBEDO = 0.25
# Prior standard deviations of the change of log F0 and logit roughness of one material for all.
_GLOSS_DEVIATION = torch.tensor([[0.1, 1.0]])
# Of several materials, with both hues.
_DIELECTRIC, _CONDUCTOR = (0.15, 1.0, 0.01, 0.01), (0.7, 1.0, 0.5, 0.5)
_DARK = 0.01  # diffuse albedo of a conductor
_METAL_ALBEDO = 0.7  # prior standard deviation of log albedo of a conductor
# Prior standard deviation of log F0 and logit roughness. They are constant in a material class, so
# it is small: wider ones scatter from texel to texel (docs/notes/several.md).
_GLOSS = 0.07
_STEEPEST = 3.0  # largest slope
# Levenberg-Marquardt: share of a parameter's precision added to the diagonal. Less overshoots;
# more leaves the trade-off of albedo and slope at its initial value.
_DAMPING = 0.005
_HALVED = 5  # fewest photographs whose halves measure both slopes
_AT_ONCE = 1 << 14  # texels solved at a time, whose equations a processor's cache holds
_HALF_PRIOR = 3.0  # factor on prior deviations for the halves, whose mean energy is measured


@dataclass(frozen=True)
class Stepped:
    """Result of a Gauss-Newton step."""

    parameters: Tensor
    """(PARAMETERS or more, H, W)."""
    precision: Tensor
    """(PARAMETERS, H, W) diagonal of the photographs' J^T W J, prior excluded."""
    relief: Tensor
    """(3, H, W) precision of slopes: xx, yy and xy of the posterior, all other parameters
    eliminated; 0 if they do not move."""
    changes: Tensor
    """(photographs, some parameters, H, W) change when each photograph is left out: the jackknife
    [efron1982]. Empty unless requested."""
    halves: Tensor
    """(2, 2, H, W) slopes by each half of the photographs alone (halves_of). Empty unless the
    changes of slopes are requested, or with fewer than _HALVED."""

    @staticmethod
    def none(parameters: Tensor) -> Stepped:
        """Before any step: precision 0, relief that of independent unit slopes."""
        empty, one = parameters.new_zeros(0), torch.ones_like(parameters[:1])
        relief = torch.cat([one, one, 0.0 * one])
        return Stepped(parameters, 0.0 * parameters[:PARAMETERS], relief, empty, empty)


@dataclass(frozen=True)
class SharedMaterials:
    """Basis reflectances: K materials, and the share of each in every texel."""

    gloss: Tensor
    """(K, 5) log mean F0 over channels, logit roughness and log specular tint (3)."""
    conductor: Tensor
    """(K,) bool: without diffuse albedo."""
    metallic: Tensor
    """(K,) bool: F0 of any level and colour, as of a conductor, or of one mixed with a dielectric
    below the size of a texel; else grey and near 0.04."""
    shares: Tensor
    """(K, H, W) shares; the sum over K is 1."""

    @property
    def metal_share(self) -> Tensor:
        """(1, H, W) share of conductors."""
        return self.shares[self.conductor].sum(0, keepdim=True)

    @property
    def metallic_share(self) -> NDArray[np.float32]:
        """(H, W) share of metallic materials."""
        return np.asarray(self.shares[self.metallic].sum(0).numpy(), np.float32)

    @property
    def deviation(self) -> Tensor:
        """(K, 4) prior standard deviations of a change of log F0, logit roughness and hues."""
        free, grey = torch.tensor(_CONDUCTOR), torch.tensor(_DIELECTRIC)
        return torch.where(self.metallic[:, None], free, grey)

    def resized(self, size: tuple[int, int]) -> SharedMaterials:
        """Area average on a grid of `size` = (rows, columns) texels."""
        return replace(self, shares=F.interpolate(self.shares[None], size=size, mode="area")[0])

    def document(self) -> list[dict[str, object]]:
        """JSON of each material: F0 by channel, roughness, whether it conducts, mean share."""
        f0 = (self.gloss[:, :1] + self.gloss[:, 2:]).exp()
        rough, share = torch.sigmoid(self.gloss[:, 1]), self.shares.mean((1, 2))
        planes = zip(f0, rough, self.conductor, share, strict=True)
        return [
            {
                "f0": [round(float(channel), 4) for channel in own],
                "roughness": round(float(alpha), 3),
                "conductor": bool(conducts),
                "share": round(float(part), 4),
            }
            for own, alpha, conducts, part in planes
        ]

    def changed(self, gloss: Tensor) -> SharedMaterials:
        """With changes (K, 4) of log F0, logit roughness and hues."""
        change = torch.cat([gloss[:, :2], gloss[:, 2:] @ HUES], dim=1)
        return replace(self, gloss=self.gloss + change)

    def onto(self, maps: MapSet) -> MapSet:
        """Maps with F0 and roughness of these materials, those of conductors without albedo."""
        log_f0, rough, *tint = torch.einsum("kg,khw->ghw", self.gloss, self.shares)[:, None]
        metal, dark = self.metal_share, math.log(_DARK)
        albedo = ((1.0 - metal) * maps.diffuse.clamp_min(1e-3).log() + metal * dark).exp()
        f0 = (log_f0 + torch.cat(tint)).exp().clamp(*F0_LIMITS)
        return replace(maps, diffuse=albedo, specular=f0, roughness=torch.sigmoid(rough))


@dataclass(frozen=True)
class Estimate:
    """Maps of the exemplar and their standard deviations."""

    maps: MapSet
    """Maps of the exemplar."""
    log_error: Tensor
    """(4, H, W) log of the standard deviations of log albedo, log F0, logit roughness and slope."""
    basis: SharedMaterials | None = None
    """Materials that texels share; None if all are one, whose F0 and roughness are the maps'."""

    def coarser(self, unit: float, extent: Extent = OWN) -> Estimate:
        """On a grid of at most `unit` texels along the first photograph's long side."""
        width, height = self.maps.size
        across = min(extent.across(unit), width)
        return self.resized((round(height * across / width), across), extent)

    def resized(self, size: tuple[int, int], extent: Extent = OWN) -> Estimate:
        """Area average on a coarser grid of `size` = (rows, columns) texels over an extent."""
        maps, log_error = (
            F.interpolate(each[None], size=size, mode="area")[0]
            for each in (self.maps.stacked(), self.log_error)
        )
        basis = None if self.basis is None else self.basis.resized(size)
        return Estimate(MapSet.from_stacked(maps, extent.texel(size[1])), log_error, basis)


@dataclass(frozen=True)
class ParameterPrior:
    """Independent Gaussian prior of each parameter of each texel."""

    mean: Tensor
    """(PARAMETERS or more, ...) mean."""
    deviation: Tensor
    """(PARAMETERS, ...) standard deviation."""
    shares: Tensor
    """(K, ...) share of each material in a texel; the sum over K is 1."""
    gloss_deviation: Tensor
    """(K, 2 or 4) prior standard deviations of SharedLight.gloss."""

    @staticmethod
    def of(estimate: Estimate) -> ParameterPrior:
        """Prior from the network's prediction, with least deviations."""
        albedo, *_, slope = estimate.log_error.clamp(-8.0, 2.0).exp().split(1)
        gloss = torch.full_like(albedo, _GLOSS).expand(2, -1, -1)
        albedo = albedo.clamp_min(_ALBEDO).expand(3, -1, -1)
        deviation = torch.cat([albedo, gloss, slope.expand(2, -1, -1)])
        mean = parameters_of(estimate.maps)
        if estimate.basis is None:
            return ParameterPrior(mean, deviation, torch.ones_like(mean[:1]), _GLOSS_DEVIATION)
        basis = estimate.basis
        deviation[ALBEDO] = torch.maximum(deviation[ALBEDO], _METAL_ALBEDO * basis.metal_share)
        return ParameterPrior(mean, deviation, basis.shares, basis.deviation)

    def at(self, chosen: Tensor) -> ParameterPrior:
        """Of some texels, indices (1, N)."""
        parts = self.mean, self.deviation, self.shares
        mean, deviation, shares = (each.flatten(1)[:, chosen] for each in parts)
        return replace(self, mean=mean, deviation=deviation, shares=shares)

    @property
    def precision(self) -> Tensor:
        """(PARAMETERS, ...) 1 / deviation^2."""
        return self.deviation.square().reciprocal()

    def with_gloss_of(self, light: SharedLight) -> ParameterPrior:
        """With SharedLight.gloss added to the means of log F0, logit roughness and tint."""
        return replace(self, mean=with_gloss(self.mean, self.shares, light.gloss))

    def with_least(self, part: slice, least: float) -> ParameterPrior:
        """With standard deviations of some parameters of at least `least`."""
        deviation = self.deviation.clone()
        deviation[part] = deviation[part].clamp_min(least)
        return replace(self, deviation=deviation)


def with_gloss(parameters: Tensor, shares: Tensor, gloss: Tensor) -> Tensor:
    """Parameters plus the changes (K, 2 or 4) of materials with shares (K, ...).

    The changes are those of log F0 and logit roughness and, of a coloured F0, along HUES.
    """
    changed = parameters.clone()
    both, hues = torch.einsum("kg,k...->g...", gloss, shares).split([2, gloss.shape[1] - 2])
    changed[GLOSS] += both
    if len(hues):
        changed[TINT] += torch.einsum("uc,u...->c...", HUES, hues)
    return changed


def parameters_of(maps: MapSet) -> Tensor:
    """(PARAMETERS, H, W) parameters of maps; with the rows of a tint if F0 has a colour."""
    surface = SurfaceParameters.of(maps)
    slopes = slopes_of(maps.height, maps.texel_size)
    log_f0 = surface.specular.mean(0, keepdim=True)
    planes = [surface.diffuse, log_f0, surface.roughness, slopes]
    if len(surface.specular) > 1:
        planes.append(surface.specular - log_f0)
    return torch.cat(planes).float()


def limited(parameters: Tensor) -> Tensor:
    """Parameters (PARAMETERS, H, W) within the limits of reflectance and slopes.

    Lobes of fits do not change below SINGLE_ROUGHNESS.
    """
    albedo, f0 = torch.tensor([ALBEDO_LIMITS, F0_LIMITS]).log()
    roughness = torch.tensor([SINGLE_ROUGHNESS, ROUGHNESS_LIMITS[1]]).logit()
    steep = torch.tensor([-_STEEPEST, _STEEPEST])
    low, high = torch.stack([albedo, albedo, albedo, f0, roughness, steep, steep], dim=1)
    solved = parameters[:PARAMETERS].clamp(low[:, None, None], high[:, None, None])
    return torch.cat([solved, parameters[PARAMETERS:]])


def maps_of(parameters: Tensor, height: Tensor, texel_size: float) -> MapSet:
    """Maps of parameters (PARAMETERS, H, W) and a height (1, H, W) that matches their slopes."""
    log_albedo, log_f0, logit_roughness, _ = parameters[:PARAMETERS].split(_PARTS)
    log_f0 = _tinted(log_f0, parameters)
    surface = SurfaceParameters(log_albedo, log_f0, logit_roughness, height / texel_size)
    return surface.maps(texel_size)


def slopes_of(height: Tensor, texel_size: float) -> Tensor:
    """(2, H, W) slopes of a height (1, H, W), plane units, by central differences."""
    normal = normals_from_height(height, texel_size)
    return -normal[:2] / normal[2:]


def log_rendered(parameters: Tensor, lights: Sequence[DifferentiableLight]) -> list[Tensor]:
    """Log radiance (3, h, w) of parameters (PARAMETERS, h, w) in each light."""
    normal, surface = _surface(parameters)
    return [light.onto(normal).log_radiance(surface)[0] for light in lights]


def as_photographed(view: ResampledView, parameters: Tensor, light: SharedLight) -> Tensor:
    """Log radiance (3, H, W) of parameters as a photograph shows them, its gains fitted to it."""
    points = points_of(view.log.shape[-2:], extent=view.extent)
    lit = light_at(0, view, replace(light, gain=torch.zeros(1, 3)), points)
    (log,) = log_rendered(parameters, [lit])
    off = (view.log - log).where(view.seen, torch.nan).flatten(1).nanmedian(1).values
    return log + off.nan_to_num(0.0)[:, None, None]


def _surface(parameters: Tensor) -> tuple[Tensor, Reflectance]:
    """Normals and reflectance of parameters (PARAMETERS, h, w)."""
    log_albedo, log_f0, logit_roughness, slopes = parameters[:PARAMETERS].split(_PARTS)
    normal, f0 = normals_from_slopes(*slopes.split(1)), _tinted(log_f0, parameters).exp()
    return normal, Reflectance(log_albedo.exp(), f0, torch.sigmoid(logit_roughness))


def _tinted(log_f0: Tensor, parameters: Tensor) -> Tensor:
    """(1 or 3, h, w) log F0 with the tint of parameters that have one."""
    return log_f0 + parameters[TINT] if len(parameters) > PARAMETERS else log_f0


def under_fitted_ambient(
    views: Resampled, parameters: Tensor, light: SharedLight
) -> list[ResampledView]:
    """Replace the ambient photograph's low frequencies by those of the rendered parameters."""

    def even(view: ResampledView) -> ResampledView:
        (rendered,) = log_rendered(parameters, [AmbientLight(light.ambient)])
        return replace(view, log=evenly_lit(view.log, view.seen, rendered))

    return [view if view.flash else even(view) for view in views]


def weights(residual: Tensor, seen: Tensor, variance: Tensor | float) -> Tensor:
    """Weights of residuals r of log radiance: 1 / (1 + (r / s)^2)^2 / variance [geman1985]."""
    kept = 1.0 / (1.0 + (residual / _ROBUST).square()).square()
    return seen * kept / variance


def robust_cost(views: Resampled, parameters: Tensor, light: SharedLight) -> Tensor:
    """(H, W) sum over photographs and channels of the cost whose weights are `weights`."""
    points = points_of(parameters.shape[-2:], extent=views[0].extent)
    lights = [light_at(k, view, light, points) for k, view in enumerate(views)]
    total = torch.zeros(parameters.shape[-2:])
    for view, log in zip(views, log_rendered(parameters, lights), strict=True):
        square = (view.log - log).square()
        cost = square / (1.0 + square / _ROBUST**2) / view.variance
        total += 0.5 * (view.seen * cost).sum(0)
    return total


def stepped(
    views: Resampled,
    parameters: Tensor,
    prior: ParameterPrior,
    light: SharedLight,
    *,
    slopes: bool = True,
    changed: slice | None = None,
) -> Stepped:
    """A Gauss-Newton step at every texel, and the jackknife changes of some parameters.

    Args:
        parameters: (PARAMETERS, H, W) current estimate.
        slopes: whether slopes move; if not, their precision is 0.
        changed: parameters whose changes without each photograph are computed; None for none.
    """
    moved, precision = parameters.clone(), torch.zeros_like(parameters[:PARAMETERS])
    relief, shape = torch.zeros(3, *parameters.shape[1:]), parameters[changed or slice(0)].shape
    changes = torch.zeros(len(views) if changed else 0, *shape)
    places = [view.camera.place[:2] for view in views]
    # Halves are of slopes alone: albedo's octaves have no use for them.
    halved = changed == SLOPES and all(view.flash for view in views)
    parts = halves_of(places) if halved else ()
    halves = torch.zeros(len(parts), *shape)
    for rows in strips(parameters.shape[1], max(1, _AT_ONCE // parameters.shape[2])):
        part = slice(PARAMETERS if slopes else SLOPES.start), rows
        of_each = _normal_equations(views, rows, parameters[:, rows], light, slopes=slopes)
        whole = sum(of_each[1:], of_each[0])
        current = parameters[part], prior.mean[part], prior.deviation[part]
        system = whole.clone() if changed else whole
        moved[part], precision[part], factor = solved(system, *current)
        if slopes:
            # L L^T, L being the block of slopes of the Cholesky factor, as they are last.
            (xx, _), (yx, yy) = factor[SLOPES, SLOPES]
            block = torch.stack([xx.square(), yx.square() + yy.square(), xx * yx])
            relief[:, rows] = block.nan_to_num(0.0).reshape(relief[:, rows].shape)
        for change, own in zip(changes, of_each, strict=bool(changed)):
            change[:, rows] = (solved(whole - own, *current)[0] - moved[part])[changed]
        wide = *current[:2], _HALF_PRIOR * current[2]
        for half, some in zip(halves, parts, strict=True):
            part_of = sum((of_each[n] for n in some[1:]), of_each[some[0]])
            half[:, rows] = solved(part_of, *wide)[0][changed]
    return Stepped(limited(moved), precision, relief, changes, halves)


def halves_of(places: Sequence[NDArray[np.float64]]) -> tuple[tuple[int, ...], ...]:
    """Two halves of the photographs, each with cameras to several sides; () of fewer than _HALVED.

    An odd number's halves share the first photograph. The halves are those whose places (2,) have
    the largest smallest spread along any direction.
    """
    count = len(places)
    if count < _HALVED:
        return ()
    shared = (0,) * (count % 2)
    others = range(len(shared), count)

    def spread(some: tuple[int, ...]) -> float:
        return float(np.linalg.eigvalsh(np.cov(np.stack([places[n] for n in some]).T))[0])

    splits = []
    for some in combinations(others, len(others) // 2):
        rest = tuple(n for n in others if n not in some)
        splits.append(((*shared, *some), (*shared, *rest)))
    return max(splits, key=lambda split: min(spread(half) for half in split))


def normal_equations(residual: Tensor, weight: Tensor, share: Tensor, by_others: Tensor) -> Tensor:
    """Normal equations J^T W J d = J^T W r of N texels under one photograph.

    Albedo of a channel changes the radiance of that channel only, so the rows of the three albedos
    are not coupled to each other.

    Args:
        residual, weight: (3, N) of log radiance.
        share: (3, N) derivative by albedo, as of `derivatives`.
        by_others: (m, 3, N) derivatives by the others.

    Returns:
        (m + 4, m + 3, N) lower triangles of J^T W J, anything above them, and J^T W r as the last
        row. Equations of several photographs are added.
    """
    system = residual.new_empty(len(by_others) + 4, len(by_others) + 3, residual.shape[-1])
    rows, weighted = torch.cat([by_others, residual[None]]), share * weight
    system[:3, :3] = 0.0
    system[:3, :3].diagonal().copy_((weighted * share).T)
    torch.mul(rows, weighted, out=system[3:, :3])
    for number, (red, green, blue) in enumerate(by_others * weight):
        column = torch.mul(rows[number:, 0], red, out=system[3 + number :, 3 + number])
        column.addcmul_(rows[number:, 1], green).addcmul_(rows[number:, 2], blue)
    return system


def solved(
    system: Tensor, parameters: Tensor, mean: Tensor, deviation: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Parameters after a damped step with a Gaussian prior; their precision, prior excluded; and
    the Cholesky factor (n + 1, n, N) of the equations.

    Args:
        system: normal_equations; overwritten.
        parameters, mean, deviation: (n, h, w) current and prior.
    """
    shape, precision = parameters.shape, deviation.flatten(1).square().reciprocal()
    measured = system.diagonal().T.clone()
    system.diagonal().T.add_(precision + _DAMPING * measured)
    system[-1] += precision * (mean - parameters).flatten(1)
    step = solved_in_place(system)[:, 0].nan_to_num(0.0).clamp(-0.7, 0.7)
    return parameters + step.reshape(shape), measured.reshape(shape), system


def _normal_equations(
    views: Resampled, rows: slice, parameters: Tensor, light: SharedLight, *, slopes: bool
) -> list[Tensor]:
    """Normal equations of each photograph at some rows, without slopes if these do not move."""
    points = points_of(views[0].log.shape[-2:], rows, views[0].extent)
    seen = [view.seen[:, rows] for view in views]
    lights = (light_at(k, view, light, points) for k, view in enumerate(views) if seen[k].any())
    shaded = derivatives(parameters, lights)
    count = PARAMETERS if slopes else SLOPES.start
    equations = []
    for view, mask in zip(views, seen, strict=True):
        if not mask.any():
            equations.append(torch.zeros(count + 1, count, parameters[0].numel()))
            continue
        log, share, by_others = next(shaded)
        residual = view.log[:, rows] - log
        weight = weights(residual, mask, view.variance).flatten(1)
        others = by_others[: count - F0]
        equations.append(normal_equations(residual.flatten(1), weight, share, others))
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


def solved_in_place(system: Tensor) -> Tensor:
    """Solutions (n, k, N) of N small systems side by side, which become their Cholesky factors.

    A third of the time of LAPACK's, which solves one system after the other. NaN where a system is
    not positive definite.

    Args:
        system: (n + k, n, N) lower triangles, the first three rows (albedo) not coupled to each
            other, and k right-hand sides as the last rows.
    """
    count = system.shape[1]
    for k in range(count):
        system[k:, k] *= system[k, k].rsqrt()
        for j in range(max(k + 1, F0), count):
            system[j:, j].addcmul_(system[j:, k], system[j, k], value=-1.0)
    solution = system[count:].movedim(0, 1).clone()
    for k in reversed(range(count)):
        solution[k] /= system[k, k]
        solution[:k].addcmul_(system[k, :k, None], solution[k], value=-1.0)
    return solution
