"""Basis reflectances: the materials that the texels of several photographs share.

Each of K materials has one F0 in colour and one roughness; a texel has a share of each, and its own
albedo and slope [lensch2003]. A texel that no photograph shows at its mirror direction has the
gloss of those of its material that some photograph does. Fitted by alternation on a coarse grid:

1. classes start from k-means of what the dimmest half of the photographs shows, F0 and roughness
   from a scan of roughness on flat cells, as a dielectric and as a conductor;
2. F0, roughness and light are fitted to a sample of texels, these eliminated (shared.py);
3. each texel's shares follow from how well each material explains all photographs of it.

K is the smallest number that predicts photographs which were held back nearly best.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
import torch
import torch.nn.functional as functional
from numpy.typing import NDArray
from torch import Tensor
from torch.distributions import MultivariateNormal

from matcap.brdf.cook_torrance import ALBEDO, F0
from matcap.capture.multiview.align import Aligned
from matcap.capture.multiview.shared import shared_step
from matcap.capture.multiview.texels import (
    GLOSS,
    PARAMETERS,
    SLOPES,
    TINT,
    Estimate,
    ParameterPrior,
    SharedMaterials,
    as_photographed,
    robust_cost,
    stepped,
    with_gloss,
)
from matcap.capture.multiview.views import Resampled, ResampledView, SharedLight, light_at
from matcap.flash.coarse.problem import CONDUCTOR_F0, DIELECTRIC_F0
from matcap.flash.geometry import points_of
from matcap.flash.light import Incident

# Settings of the fit; docs/notes/several.md.
_ACROSS = 160  # texels across the grid
_TRIED = (1, 2, 3, 4, 6, 8)  # numbers of materials
_ENOUGH = 0.95  # a larger number must reduce the error of photographs held back to this share
_HELD_OUT = 3  # every third photograph is held back
_ROUNDS, _STEPS = 3, 2  # alternations, and Gauss-Newton steps of texels in each
_SAMPLED = 3000  # texels to which F0, roughness and light are fitted
_SLOPE = 0.2  # prior standard deviation of slopes
_COUNTED = 0.03  # weight of a residual in a texel's shares, as errors are correlated
_BLUR = 0.7  # texels, standard deviation of the smoothing of costs
_COLOUR, _LEAST_SPREAD = 1.0, 0.1  # weight and least deviation of a material's colour
_VIGNETTING = (0.3, 0.3)  # initial, as the falloff of one photograph takes a metal's highlight
_MOST_F0 = 0.95  # of any material
_CELL = 4  # side of a cell of the scan, texels
_ROUGH = (0.12, 0.18, 0.25, 0.33, 0.42, 0.52, 0.64, 0.78)  # tried by the scan
_SCALE = 0.5  # scale of the scan's robust cost of log radiance
_FAR = math.log(3.0)  # log F0 over that of a dielectric from which a material is metallic
# Log specular tint of a metallic material, at least, and precision of its log F0.
_HUE, _CERTAIN = 0.3, 4.0
_CONDUCTS = 0.9  # a conductor's cost over the dielectric's, at most
_LEAST_SHARE = 0.005  # of the texels: smaller materials are dropped
_DARK_CODE = 0.003  # radiance added before the code of the error of prediction
# Of the guided filter that refines shares: coarse texels, and log radiance.
_RADIUS, _SMOOTH = 3, 0.05

Floats = NDArray[np.float32]


def with_basis(alignment: Aligned, prediction: Estimate) -> tuple[Aligned, Estimate]:
    """The prediction with F0 and roughness of shared materials, and the light fitted with them.

    Both unchanged if one material predicts held-back photographs as well, or fewer than three have
    flash.
    """
    small = prediction.coarser(_ACROSS, alignment.extent)
    fitted = fit_basis(alignment.on_grid(*small.maps.size), small, alignment.light)
    if fitted is None:
        return alignment, prediction
    coarse, light = fitted
    fine = alignment.on_grid(*prediction.maps.size)
    guide = _dimmest(fine, light).clamp_min(1e-3).log().numpy()
    basis = replace(coarse, shares=torch.from_numpy(_refined(coarse.shares.numpy(), guide)))
    brighter = (alignment.light.intensity / light.intensity)[:, None, None]
    maps = replace(prediction.maps, diffuse=prediction.maps.diffuse * brighter)
    prediction = replace(prediction, maps=basis.onto(maps), basis=basis)
    return replace(alignment, light=light), prediction


def fit_basis(
    views: Resampled, prediction: Estimate, light: SharedLight
) -> tuple[SharedMaterials, SharedLight] | None:
    """The materials that predict held-back photographs best, and the light fitted with them.

    None if one does, if any photograph is without flash, or with fewer than three. Photographs and
    the network's prediction are on the same coarse grid.
    """
    if len(views) < 3 or not all(view.flash for view in views):
        return None
    fit = _chosen(views, prediction, light)
    if fit is None:
        return None
    return fit.current, replace(fit.light, gloss=torch.zeros_like(fit.light.gloss))


@dataclass(frozen=True)
class _Fit:
    """Materials, and the texels under them."""

    views: Resampled
    prediction: Estimate
    """The network's, whose albedo is the prior of dielectrics'."""
    basis: SharedMaterials
    """Prior means of the materials; SharedLight.gloss is their change."""
    certain: Tensor
    """(K,) precision of each material's log F0, for the common scale of all."""
    light: SharedLight
    parameters: Tensor
    """(PARAMETERS or more, H, W) of the texels."""

    @staticmethod
    def begun(views: Resampled, prediction: Estimate, light: SharedLight) -> _Fit:
        """One material: the prediction."""
        prior = ParameterPrior.of(prediction)
        light = replace(light, gloss=torch.zeros_like(prior.gloss_deviation))
        no = torch.zeros(1, dtype=torch.bool)
        basis = SharedMaterials(torch.zeros(1, 5), no, no, prior.shares)
        return _Fit(views, prediction, basis, torch.zeros(1), light, prior.mean)

    @property
    def current(self) -> SharedMaterials:
        """The materials."""
        return self.basis.changed(self.light.gloss)

    @property
    def prior(self) -> ParameterPrior:
        """Of the texels, before SharedLight.gloss, with slopes of 0."""
        prediction = self.prediction
        if self.light.gloss.shape[1] > 2:
            maps = self.basis.onto(prediction.maps)
            prediction = replace(prediction, maps=maps, basis=self.basis)
        prior = ParameterPrior.of(prediction)
        prior.mean[SLOPES] = 0.0
        prior.deviation[SLOPES] = _SLOPE
        return prior

    def restarted(self, slopes: Tensor | float) -> _Fit:
        """With the materials' gloss, albedo of dielectrics as the dimmest photographs show it."""
        parameters = self.prior.with_gloss_of(self.light).mean
        albedo = (math.pi * _dimmest(self.views, self.light)).clamp(1e-3, 1.0).log()
        parameters[ALBEDO] = torch.lerp(albedo, parameters[ALBEDO], self.basis.metal_share)
        parameters[SLOPES] = slopes
        return replace(self, parameters=parameters)

    def stepped(self) -> _Fit:
        """Gauss-Newton steps of the texels."""
        prior, parameters = self.prior.with_gloss_of(self.light), self.parameters
        for _ in range(_STEPS):
            parameters = stepped(self.views, parameters, prior, self.light).parameters
        return replace(self, parameters=parameters)

    def with_shared(self) -> _Fit:
        """Fit materials and light, the texels eliminated."""
        light, _ = shared_step(self.views, self.parameters, self.prior, self.light, _SAMPLED)
        change = light.gloss - self.light.gloss
        parameters = with_gloss(self.parameters, self.basis.shares, change)
        return replace(self, light=light, parameters=parameters)

    def with_shares(self, shares: Tensor) -> _Fit:
        """With other shares, without materials of hardly any texel."""
        kept = shares.mean((1, 2)) >= _LEAST_SHARE
        shares = shares[kept] / shares[kept].sum(0).clamp_min(1e-6)
        light = replace(self.light, gloss=self.light.gloss[kept])
        old = self.basis
        basis = SharedMaterials(old.gloss[kept], old.conductor[kept], old.metallic[kept], shares)
        fit = replace(self, basis=basis, certain=self.certain[kept], light=light)
        mean, parameters = fit.prior.with_gloss_of(light).mean, self.parameters.clone()
        parameters[GLOSS], parameters[TINT] = mean[GLOSS], mean[TINT]
        return replace(fit, parameters=parameters)

    def scaled(self, factor: Tensor) -> _Fit:
        """With albedo and F0 multiplied by exp(factor), (1,) or (3,), under as much less light."""
        maps = self.prediction.maps
        diffuse = maps.diffuse * factor.exp()[:, None, None]
        intensity, gloss = self.light.intensity / factor.exp(), self.light.gloss.clone()
        gloss[:, 0] += factor.mean()
        parameters = self.parameters.clone()
        parameters[F0] += factor.mean()
        parameters[ALBEDO] += factor[:, None, None] * (1.0 - self.basis.metal_share)
        return replace(
            self,
            prediction=replace(self.prediction, maps=replace(maps, diffuse=diffuse)),
            light=replace(self.light, intensity=intensity, gloss=gloss),
            parameters=parameters,
        )

    def with_metallic(self) -> _Fit:
        """Materials far above a dielectric become metallic: F0 of dielectrics is nearly one."""
        gloss, grey = self.current.gloss, ~self.basis.metallic
        if not grey.any():
            return self
        bright = grey & (gloss[:, 0] > gloss[grey, 0].min() + _FAR)
        base = gloss.where(bright[:, None], self.basis.gloss)
        basis = replace(self.basis, gloss=base, metallic=self.basis.metallic | bright)
        light = replace(self.light, gloss=self.light.gloss.masked_fill(bright[:, None], 0.0))
        certain = self.certain.masked_fill(bright, CONDUCTOR_F0.deviation**-2)
        return replace(self, basis=basis, light=light, certain=certain)

    def calibrated(self) -> _Fit:
        """With the scale at which F0 of all materials is most probable."""
        means = torch.tensor([DIELECTRIC_F0.mean, CONDUCTOR_F0.mean])[self.basis.metallic.int()]
        weights = self.certain * self.basis.shares.mean((1, 2))
        gloss = self.current.gloss
        off = (weights * (means - gloss[:, 0])).sum() / weights.sum().clamp_min(1e-9)
        brightest = (gloss[:, :1] + gloss[:, 2:]).max()
        return self.scaled(torch.minimum(off, math.log(_MOST_F0) - brightest)[None])


def _chosen(views: Resampled, small: Estimate, light: SharedLight) -> _Fit | None:
    """The fit of the best number of materials to all photographs; None for one."""
    held_out = [n for n in range(1, len(views)) if n % _HELD_OUT == _HELD_OUT - 1]
    kept = [n for n in range(len(views)) if n not in held_out]
    some, of_some = [views[n] for n in kept], light.of_some(kept)
    best, least, misses = 1, math.inf, 0
    for count in _TRIED:
        fit = _fitted(some, small, of_some, count)
        error = float(np.mean([_predicted(views[n], fit) for n in held_out]))
        if error < _ENOUGH * least:
            best, least, misses = count, error, 0
        else:
            misses += 1
        if misses == 2:
            break
    return None if best == 1 else _fitted(views, small, light, best)


def _fitted(views: Resampled, small: Estimate, light: SharedLight, count: int) -> _Fit:
    """Alternate between materials, texels and shares, from `count` clusters.

    One material is the prediction with its own F0 and roughness.
    """
    fit = _Fit.begun(views, small, light)
    if count > 1:
        fit = _started(fit, _clusters(_dimmest(views, light), count)).restarted(0.0)
    for number in range(_ROUNDS):
        fit = fit.with_shared().stepped()
        fit = fit.with_metallic().calibrated() if count > 1 else fit
        if count > 1 and number < _ROUNDS - 1:
            fit = fit.with_shares(_shares(fit))
    return fit


def _shares(fit: _Fit) -> Tensor:
    """(K, H, W) shares by the cost of each texel as either material, albedo and slope refitted."""
    costs = []
    for number, conducts in enumerate(fit.basis.conductor):
        shares = torch.zeros_like(fit.basis.shares)
        shares[number] = 1.0
        only = replace(fit, basis=replace(fit.basis, shares=shares))
        only = only.restarted(fit.parameters[SLOPES]).stepped()
        cost = robust_cost(fit.views, only.parameters, fit.light) * _COUNTED
        off = (only.parameters - only.prior.mean)[:PARAMETERS] / only.prior.deviation
        for part in (SLOPES, ALBEDO) if conducts else (SLOPES,):
            cost = cost + 0.5 * off[part].square().sum(0)
        costs.append(torch.from_numpy(cv2.GaussianBlur(cost.numpy(), (0, 0), _BLUR)))
    total = torch.stack(costs)
    if len(total) > 1:
        features = _features(_dimmest(fit.views, fit.light))
        total = total + _COLOUR * _colour_costs(features, torch.softmax(-total, 0))
    return torch.softmax(-total, 0)


def _colour_costs(features: Tensor, shares: Tensor) -> Tensor:
    """(K, H, W) negative log density of features (3, H, W) by material, as Gaussians.

    A texel whose gloss no photograph shows has that of texels of its colour.
    """
    flat, costs = features.flatten(1), []
    for share in shares.flatten(1):
        total = share.sum().clamp_min(1e-6)
        mean = (flat * share).sum(1) / total
        off = flat - mean[:, None]
        covariance = (off * share) @ off.T / total + _LEAST_SPREAD**2 * torch.eye(3)
        density = MultivariateNormal(mean, covariance).log_prob(flat.T)
        costs.append(-density - (total / share.numel()).log())
    return torch.stack(costs).reshape(shares.shape)


def _reflected(views: Resampled, light: SharedLight) -> Tensor:
    """(n, 3, H, W) radiance over irradiance of the flat plane, NaN where not seen."""
    lit = _on_flat_plane(views, light, views[0].log.shape[-2:])
    return torch.stack(
        [
            (view.log.exp() / on.irradiance).where(view.seen.all(0), torch.nan)
            for view, on in zip(views, lit, strict=True)
        ]
    )


def _on_flat_plane(views: Resampled, light: SharedLight, size: tuple[int, ...]) -> list[Incident]:
    """Each photograph's light on the flat plane, on a grid of `size` = (rows, columns)."""
    points, up = points_of(size, extent=views[0].extent), torch.zeros(3, *size)
    up[2] = 1.0
    return [light_at(n, view, light, points).onto(up) for n, view in enumerate(views)]


def _dimmest(views: Resampled, light: SharedLight) -> Tensor:
    """(3, H, W) mean of the dimmest half of the photographs of each texel, over irradiance."""
    reflected = _reflected(views, light)
    order = reflected.sum(1, keepdim=True).nan_to_num(torch.inf).argsort(0).expand_as(reflected)
    return reflected.gather(0, order)[: max(1, len(views) // 2)].nanmean(0).nan_to_num(1e-3)


def _clusters(dim: Tensor, count: int) -> Tensor:
    """(count, H, W) one-hot clusters of the features of `dim` (3, H, W)."""
    flat = np.ascontiguousarray(_features(dim).flatten(1).T.numpy())
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
    cv2.setRNGSeed(0)
    labels = cv2.kmeans(flat, count, None, stop, 5, cv2.KMEANS_PP_CENTERS)[1][:, 0]  # type: ignore[call-overload]
    one_hot = functional.one_hot(torch.from_numpy(labels).long(), count).float()
    return one_hot.T.reshape(count, *dim.shape[1:])


def _features(dim: Tensor) -> Tensor:
    """(3, H, W) log ratios and log luminance of what the dimmest photographs show (3, H, W)."""
    log = dim.clamp_min(1e-4).log().numpy()
    red, green, blue = (cv2.GaussianBlur(plane, (0, 0), 1.0) for plane in log)
    ratios = 2.0 * (red - green), 2.0 * (blue - green)
    features = np.stack([*ratios, 0.7 * (red + green + blue) / 3.0])
    return torch.from_numpy(np.asarray(features, np.float32))


def _started(fit: _Fit, shares: Tensor) -> _Fit:
    """Materials of given shares by a scan of roughness on flat cells, under a white flash.

    Each is a dielectric or a conductor, whichever explains the cells better.
    """
    white = fit.light.intensity.log().mean().exp().expand(3)
    light = replace(fit.light, intensity=white, vignetting=torch.tensor(_VIGNETTING))
    reflected, lobes = _reflected(fit.views, light), _lobes(fit.views, light)
    gloss, certain, conductor = [], [], []
    for share in shares:
        cells = _cell_means(reflected, share)
        matte, metal = (_scanned(cells, lobes, conducts=each) for each in (False, True))
        conductor.append(metal.cost < _CONDUCTS * matte.cost)
        scanned = metal if conductor[-1] else matte
        log_f0, rough = scanned.f0.log(), scanned.roughness
        level = log_f0.mean(0, keepdim=True)
        gloss.append(torch.cat([level, torch.tensor([rough]).logit(), log_f0 - level]))
        prior = CONDUCTOR_F0 if conductor[-1] else DIELECTRIC_F0
        error = 0.0 if conductor[-1] else rough  # a wide lobe may be albedo's, or the falloff's
        variance = prior.deviation**2 + error**2 + 1.0 / max(scanned.information, 1e-6)
        certain.append(1.0 / variance)
    conducts, coloured = torch.tensor(conductor), torch.stack(gloss)[:, 2:].abs().amax(1) > _HUE
    metallic = conducts | (coloured & (torch.tensor(certain) > _CERTAIN))
    basis = SharedMaterials(torch.stack(gloss), conducts, metallic, shares)
    nothing = torch.zeros(len(shares), 4)
    light = replace(light, gloss=nothing)
    fit = replace(fit, basis=basis, certain=torch.tensor(certain), light=light)
    fit = replace(fit, parameters=fit.prior.mean).calibrated()
    # The prior of dielectrics is grey and 0.04, that of conductors what the scan measured.
    base, grey = fit.current.gloss, ~basis.metallic
    base[grey, 0], base[grey, 2:] = DIELECTRIC_F0.mean, 0.0
    return replace(fit, basis=replace(basis, gloss=base), light=replace(fit.light, gloss=nothing))


class _Scanned(NamedTuple):
    """A material of one roughness on flat cells."""

    cost: float
    """Mean robust cost."""
    roughness: float
    f0: Tensor
    """(3,) F0."""
    information: float
    """Precision of log F0: 1 / variance."""


def _scanned(cells: Tensor, lobes: Sequence[Tensor], *, conducts: bool) -> _Scanned:
    """The best fit of cells (n, 3, h, w) by one of the lobes (n, 1, h, w) of _ROUGH.

    Of a dielectric, cells have an albedo of their own and F0 in common; of a conductor, each its
    own scale of F0.
    """
    seen, light = ~cells.isnan(), cells.nan_to_num(1.0).clamp_min(1e-6)
    fitted, scanned = _conductor if conducts else _dielectric, []
    for lobe, rough in zip(lobes, _ROUGH, strict=True):
        kept, f0, residual, contrast = seen.float(), torch.full((3, 1, 1), 0.04), light, light
        for _ in range(6):
            f0, rendered, contrast = fitted(light, lobe, seen * kept, f0)
            residual = (light.log() - rendered.clamp_min(1e-6).log()) / _SCALE
            kept = (1.0 + residual.square()).reciprocal().square()
        square = residual.square()
        cost = float((seen * square / (1.0 + square)).sum() / seen.sum().clamp_min(1))
        information = float((contrast * seen * kept).sum())
        scanned.append(_Scanned(cost, rough, f0.flatten(), information))
    return min(scanned, key=lambda one: one.cost)


def _dielectric(light: Tensor, lobe: Tensor, kept: Tensor, f0: Tensor) -> tuple[Tensor, ...]:
    """F0 (3, 1, 1), what it renders, and each cell's information on its log."""
    given = kept / light.square()
    albedo = (given * (light - f0 * lobe)).sum(0) / given.sum(0).clamp_min(1e-9)
    albedo, over = albedo.clamp_min(1e-4), given * lobe
    f0 = (over * (light - albedo)).sum((0, 2, 3)) / (over * lobe).sum((0, 2, 3)).clamp_min(1e-9)
    f0 = f0.clamp(1e-3, 1.0)[:, None, None]
    rendered = albedo + f0 * lobe
    glossy = f0 * lobe / rendered
    mean = glossy.where(kept > 0.0, torch.nan).nanmean(0).nan_to_num(0.0)
    return f0, rendered, (glossy - mean).square() / (3.0 * _SCALE**2)


def _conductor(light: Tensor, lobe: Tensor, kept: Tensor, _f0: Tensor) -> tuple[Tensor, ...]:
    """As _dielectric, of cells without albedo."""
    log, by_cell = light.log() - lobe.clamp_min(1e-6).log(), kept.sum(0)
    scale = (kept * log).sum(0) / by_cell.clamp_min(1e-6)
    f0 = ((by_cell * scale).sum((1, 2)) / by_cell.sum((1, 2)).clamp_min(1e-6)).exp()
    return f0[:, None, None], scale.exp() * lobe.clamp_min(1e-6), torch.ones_like(kept)


def _predicted(view: ResampledView, fit: _Fit) -> float:
    """Mean absolute error of the code of a photograph that was held back, its gains fitted."""
    rendered = as_photographed(view, fit.parameters, fit.light)
    error = (_code(rendered) - _code(view.log)).abs().where(view.seen, torch.nan)
    return float(error.flatten(1).nanmean(1).nanmean())


def _code(log: Tensor) -> Tensor:
    """Code of log radiance, in which errors count about as the eye counts them."""
    return (log.exp().clamp_max(1.0) + _DARK_CODE) ** (1.0 / 2.4)


def _refined(shares: Floats, fine: Floats) -> Floats:
    """(K, H, W) shares (K, h, w) on the grid of a guide, by a guided filter [he2013].

    Args:
        shares: of a coarse grid.
        fine: (3, H, W) guide, log radiance.
    """
    size, guide = fine.shape[:0:-1], np.ascontiguousarray(np.moveaxis(fine, 0, -1))
    radius = max(1, round(_RADIUS * size[0] / shares.shape[2]))
    wide = (cv2.resize(share, size, interpolation=cv2.INTER_LINEAR) for share in shares)
    refined = [cv2.ximgproc.guidedFilter(guide, share, radius, _SMOOTH**2) for share in wide]
    sharp = np.stack(refined).clip(1e-3, 1.0) ** 2
    return np.asarray(sharp / sharp.sum(0), np.float32)


def _lobes(views: Resampled, light: SharedLight) -> list[Tensor]:
    """(n, 1, h, w) specular radiance over irradiance of F0 = 1 on flat cells, by roughness."""
    height, width = (max(1, side // _CELL) for side in views[0].log.shape[-2:])
    lit = _on_flat_plane(views, light, (height, width))
    one = torch.ones(1, height, width)
    return [torch.stack([on.mirrored(one, rough * one) for on in lit]) for rough in _ROUGH]


def _cell_means(reflected: Tensor, share: Tensor) -> Tensor:
    """(n, 3, h, w) means over the texels of a material in each cell, NaN without enough of them."""
    weight = share * ~reflected.isnan().any(1, keepdim=True)
    sums = reflected.nan_to_num(0.0) * weight, weight
    mean, count = (functional.avg_pool2d(each, _CELL) for each in sums)
    return (mean / count.clamp_min(1e-6)).where(count > 0.2, torch.nan)
