"""Shared parameters: gains, flash position, vignetting and photograph registration.

Misregistration can be absorbed by spurious slopes and then leaves no residual. The shared
parameters are therefore solved by variable projection [golub1973]: at a sample of texels, the
texels' own parameters are eliminated from the normal equations (Schur complement), so that only
residuals they cannot explain change the shared ones.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor

from matcap.brdf.cook_torrance import ALBEDO, F0
from matcap.capture.multiview.texels import (
    GLOSS,
    HUES,
    PARAMETERS,
    ParameterPrior,
    derivatives,
    log_rendered,
    normal_equations,
    solved_in_place,
    weights,
    with_gloss,
)
from matcap.capture.multiview.views import Resampled, SharedLight, by_vignetting, light_at
from matcap.capture.registration.camera import Doubles
from matcap.flash.geometry import OWN, points_of
from matcap.flash.light import DifferentiableLight

_ROUNDING = 1e-5  # damping of the diagonal against rounding in single precision

# Estimation of the shared parameters; docs/notes/several.md.
SAMPLED = 4000  # texels to which they are fitted
_STEPS = 3  # Gauss-Newton steps
_COUNTED = 0.03  # weight of a texel, below 1 as errors of neighbouring texels are correlated
_LARGEST_MOVE = 2.0  # largest displacement of a photograph in a step, texels
# Prior standard deviations: of the flash position, and of a photograph's registration, plane units.
_OFFSET_DEVIATION, _MISREGISTRATION = 0.06, 0.004
# Largest distance of the flash, along each axis, from where the coarse fit has it, plane units:
# shading that is not the flash's (folds of cloth, room light) moved it beyond any phone.
_LARGEST_OFFSET = 0.15
# Least prior standard deviation of log albedo: an error of the prediction's mean is common to all
# texels, and a narrow one would say it as often as there are texels. Not of two photographs, which
# hardly tell a lobe from albedo.
_ALBEDO_DEVIATION = 1.0
# Share of the prior deviations of gloss where one photograph alone has flash, which the prediction
# has already used.
_KNOWN_GLOSS = 0.01
_GAIN = 1.5  # prior standard deviation of the log gain of a photograph


class _SharedParameters(NamedTuple):
    """Shared parameters; also their indices in the vector, and their prior deviations."""

    offset: Tensor
    """(2,) of the flash."""
    vignetting: Tensor
    """(2,) with r^2 and with r^4."""
    gloss: Tensor
    """(K, 2 or 4) SharedLight.gloss."""
    gain: Tensor
    """(photographs - 1, 3) log gains of every photograph but the first."""
    move: Tensor
    """(photographs - 1, 8) change of its homography; (photographs - 1, 0) if none is moved."""

    @staticmethod
    def of(light: SharedLight, *, moving: bool) -> _SharedParameters:
        """Those of a light, with zero change of registration."""
        parts = light.offset, light.vignetting, light.gloss, light.gain[1:]
        move = torch.zeros(len(light.gain) - 1, 8 * moving)
        return _SharedParameters(*(part.double() for part in (*parts, move)))

    def vector(self) -> Tensor:
        """(n,) all of them."""
        return torch.cat([part.flatten() for part in self])

    def parts(self, vector: Tensor) -> _SharedParameters:
        """Views of a vector (n,) as parts of these shapes."""
        flat = vector.split([part.numel() for part in self])
        return _SharedParameters(*(v.view(p.shape) for v, p in zip(flat, self, strict=True)))

    def onto(self, light: SharedLight) -> SharedLight:
        """`light` with these parameters."""
        offset, vignetting, gloss, gain, _ = (part.float() for part in self)
        gain = functional.pad(gain, (0, 0, 1, 0))
        return replace(light, offset=offset, vignetting=vignetting, gloss=gloss, gain=gain)


def shared_step(
    views: Resampled,
    parameters: Tensor,
    prior: ParameterPrior,
    light: SharedLight,
    sampled: int = SAMPLED,
    moved: Collection[int] = (),
) -> tuple[SharedLight, list[Doubles]]:
    """Gauss-Newton steps on all shared parameters, texels eliminated (Schur complement).

    Returns the light, and each photograph's change of registration, a (3, 3) homography.

    Args:
        views: photographs on the grid; the first one's registration is fixed.
        parameters: (PARAMETERS, H, W) current estimate.
        light: current estimate.
        sampled: texels to which the parameters are fitted.
        moved: indices of photographs to register; the others get the identity.
    """
    chosen = _chosen(views, sampled)
    some = parameters.flatten(1)[:, chosen]
    start = _SharedParameters.of(light, moving=bool(moved))
    some_prior = prior.at(chosen)
    if sum(view.flash for view in views) > 2:
        some_prior = some_prior.with_least(ALBEDO, _ALBEDO_DEVIATION)
    problem = _SharedFit.of(views, chosen, some_prior, light, start)
    values = start.vector()
    deviations = _deviations(views, light, start, prior, moved).vector()
    # Prior means of gloss and flash offset are always the prediction's and the coarse fit's.
    flash = light.coarse_offset.double()
    expected = start._replace(gloss=torch.zeros_like(start.gloss), offset=flash).vector()
    largest_move = _LARGEST_MOVE * views[0].extent.texel(parameters.shape[-1])
    for _ in range(_STEPS):
        matrix, right, texel_step, by_shared = problem.equations(some, values).reduced()
        matrix = _COUNTED * matrix + torch.diag(deviations**-2)
        right = _COUNTED * right + (expected - values) / deviations**2
        step = torch.linalg.solve(matrix, right)
        start.parts(step).move.clamp_(-largest_move, largest_move)
        values = values + step.clamp(-1.5, 1.5)
        start.parts(values).offset.clamp_(flash - _LARGEST_OFFSET, flash + _LARGEST_OFFSET)
        texel_step = texel_step - (by_shared * step.float()[:, None]).sum(1)
        some = some.clone()
        some[:PARAMETERS] += texel_step.clamp(-0.7, 0.7)[:, None]
        hues = start.parts(step.clamp(-1.5, 1.5)).gloss.float().clone()
        hues[:, :2] = 0.0  # texels have log F0 and roughness of their own
        some = with_gloss(some, problem.prior.shares, hues)
    result = start.parts(values)
    moves = [_homography(move) for move in result.move] if moved else []
    return result.onto(light), [np.eye(3)] * (len(views) - len(moves)) + moves


def _deviations(
    views: Resampled,
    light: SharedLight,
    start: _SharedParameters,
    prior: ParameterPrior,
    moved: Collection[int],
) -> _SharedParameters:
    """Prior standard deviations."""
    one_flash = sum(view.flash for view in views) == 1
    moves = [_MISREGISTRATION if number in moved else 1e-9 for number in range(1, len(views))]
    return _SharedParameters(
        torch.full_like(start.offset, _OFFSET_DEVIATION),
        torch.tensor(light.vignetting_deviation, dtype=torch.float64),
        (_KNOWN_GLOSS * prior.gloss_deviation if one_flash else prior.gloss_deviation).double(),
        torch.full_like(start.gain, _GAIN),
        torch.tensor(moves, dtype=torch.float64)[:, None].expand(start.move.shape),
    )


def _chosen(views: Resampled, count: int) -> Tensor:
    """(1, count) random texel indices; in a mosaic, of texels that two photographs show."""
    generator = torch.Generator().manual_seed(0)
    chosen = torch.randint(views[0].log[0].numel(), (1, count), generator=generator)
    if views[0].extent == OWN:
        return chosen
    shared = torch.stack([view.seen.all(0) for view in views]).sum(0) > 1
    places = shared.flatten().nonzero()[:, 0]
    return places[chosen % len(places)] if len(places) else chosen


def _gradient(log: Tensor, chosen: Tensor, texel: float) -> tuple[Tensor, Tensor]:
    """(3, 1, N) each: d log L / dx (right) and d log L / dy (up), per plane unit.

    Fourth order: second-order differences underestimate the gradient of a weave of period four
    texels, and registration steps then overshoot and oscillate.

    Args:
        log: (3, H, W) log radiance.
        chosen: (1, N) indices of texels.
        texel: side of a texel, plane units.
    """
    right = torch.tensor([1.0, -8.0, 0.0, 8.0, -1.0])[None, None, None] / (12.0 * texel)
    padded = functional.pad(log[:, None], (2, 2, 2, 2), mode="reflect")
    dx = functional.conv2d(padded[..., 2:-2, :], right)
    dy = -functional.conv2d(padded[..., 2:-2], right.mT)
    return dx.flatten(1)[:, chosen], dy.flatten(1)[:, chosen]


@dataclass(frozen=True)
class _Equations:
    """Normal equations of N texels' parameters t and the shared ones s, modified in place.

    For each texel A dt + B ds = a, and for all, C ds + sum over texels of B^T dt = c.
    """

    texels: Tensor
    """(PARAMETERS + 1 + n, PARAMETERS, N) lower triangles of A, then a, then B^T."""
    shared: Tensor
    """(n, n + 1) C and, as the last column, c; double precision."""

    @staticmethod
    def of_prior(prior: ParameterPrior, some: Tensor, values: Tensor, gloss: Tensor) -> _Equations:
        """Equations by the texels' prior, whose means of gloss are shared: hierarchical.

        Args:
            prior: of the texels, (PARAMETERS, 1, N).
            some: (PARAMETERS or more, 1, N) texel parameters.
            values: (n,) shared parameters.
            gloss: (K, 2 or 4) indices of _SharedParameters.gloss.
        """
        precision, count = prior.precision[:, 0], len(values)
        shares, shared = prior.shares[:, 0], torch.zeros(count, count + 1, dtype=torch.float64)
        texels = torch.zeros(PARAMETERS + 1 + count, PARAMETERS, some.shape[-1])
        texels.diagonal().T.copy_(precision)
        right = texels[PARAMETERS]
        right += precision * (prior.mean - some)[:PARAMETERS, 0]
        right[GLOSS] += precision[GLOSS] * (values[gloss[:, :2]].float().T @ shares)
        for row, own in zip(range(PARAMETERS)[GLOSS], gloss[:, :2].T, strict=True):
            weighted = shares * precision[row]
            texels[PARAMETERS + 1 + own, row] = -weighted
            shared[own[:, None], own] = weighted.double() @ shares.double().T
            shared[own, -1] = -(shares.double() @ right[row].double())
        return _Equations(texels, shared)

    def add(self, of_texels: Sequence[Tensor], by_shared: Tensor, indices: Tensor) -> None:
        """Add the equations of a photograph.

        Args:
            of_texels: arguments of normal_equations.
            by_shared: (k, 3, N) derivatives of log radiance by some shared parameters.
            indices: (k,) of these.
        """
        residual, weight, share, by_others = of_texels
        self.texels[: PARAMETERS + 1] += normal_equations(*of_texels)
        weighted, rows = by_shared * weight, PARAMETERS + 1 + indices
        self.texels[rows, :F0] += weighted * share
        for column, by_other in enumerate(by_others, F0):
            self.texels[rows, column] += (weighted * by_other).sum(1)
        both = torch.cat([by_shared, residual[None]]).double().flatten(1)
        columns = torch.cat([indices, torch.tensor([-1])])
        self.shared[indices[:, None], columns] += weighted.double().flatten(1) @ both.T

    def reduced(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Equations of the shared parameters, texels eliminated (Schur complement).

            (C - sum B^T A^-1 B) ds = c - sum B^T A^-1 a,    dt = A^-1 a - A^-1 B ds.

        Solutions of texels whose equations are singular in single precision are set to 0, as an
        arbitrary step would propagate into the shared parameters.

        Returns:
            (n, n) matrix and (n,) right-hand side; (PARAMETERS, N) A^-1 a; (PARAMETERS, n, N)
            A^-1 B.
        """
        system = self.texels.clone()
        system.diagonal().mul_(1.0 + _ROUNDING)
        solved = solved_in_place(system).nan_to_num(0.0, 0.0, 0.0)
        coupling = self.texels[PARAMETERS + 1 :].movedim(1, 0)
        eliminated = (coupling.double() @ solved.double().mT).sum(0)
        matrix = self.shared[:, :-1] - eliminated[:, 1:]
        right = self.shared[:, -1] - eliminated[:, 0]
        return matrix, right, solved[:, 0], solved[:, 1:]


@dataclass(frozen=True)
class _SharedFit:
    """The least-squares problem at N sampled texels."""

    views: Resampled
    """The photographs at these texels, (3, 1, N)."""
    points: Tensor
    """(3, 1, N) plane points."""
    by_move: Sequence[Tensor]
    """(8, 3, 1, N) d log L / d homography of each photograph; empty if none is moved."""
    prior: ParameterPrior
    """Prior of the sampled texels' parameters."""
    light: SharedLight
    """Gives the properties that are not fitted."""
    start: _SharedParameters
    """Initial shared parameters."""

    @staticmethod
    def of(
        views: Resampled,
        chosen: Tensor,
        prior: ParameterPrior,
        light: SharedLight,
        start: _SharedParameters,
    ) -> _SharedFit:
        """The problem at the texels `chosen` (1, N), with image gradients if any is moved."""
        size, extent = views[0].log.shape[-2:], views[0].extent
        points = points_of(size, extent=extent).flatten(1)[:, chosen]
        by_move, (x, y, _) = [], points
        for view in views if start.move.numel() else ():
            dx, dy = _gradient(view.log, chosen, extent.texel(size[-1]))
            radial = x * dx + y * dy
            moves = [dx, dx * x, dx * y, dy, dy * x, dy * y, x * radial, y * radial]
            by_move.append(torch.stack(moves))
        few = [
            replace(v, log=v.log.flatten(1)[:, chosen], seen=v.seen.flatten(1)[:, chosen])
            for v in views
        ]
        return _SharedFit(few, points, by_move, prior, light, start)

    def equations(self, some: Tensor, values: Tensor) -> _Equations:
        """Normal equations at texel parameters (PARAMETERS, 1, N) and shared ones (n,)."""
        index = self.start.parts(torch.arange(len(values)))
        equations = _Equations.of_prior(self.prior, some, values, index.gloss)
        lights = [self._lit(number, values) for number in range(len(self.views))]
        shaded = derivatives(some, lights)
        for (number, view), (log, *by_texel) in zip(enumerate(self.views), shaded, strict=True):
            residual = view.log - log
            if number and self.by_move:
                move = self.start.parts(values).move[number - 1].float()
                residual = view.log + torch.einsum("i,icxn->cxn", move, self.by_move[number]) - log
            weight = weights(residual, view.seen, view.variance)[:, 0]
            by_shared, indices = self._by_shared(number, some, log, values, index)
            by_hue, hues = self._by_hue(by_texel[1][0], index.gloss)
            by_shared, indices = torch.cat([by_shared, by_hue]), torch.cat([indices, hues])
            equations.add((residual[:, 0], weight, *by_texel), by_shared, indices)
        return equations

    def _by_hue(self, by_f0: Tensor, gloss: Tensor) -> tuple[Tensor, Tensor]:
        """(k, 3, N) d log L / d hues of the materials, and their indices (k,).

        Args:
            by_f0: (3, N) d log L / d log F0.
            gloss: (K, 2 or 4) indices of the materials' parameters.
        """
        hues = gloss[:, 2:]
        changes = torch.einsum("kn,cn,uc->kucn", self.prior.shares[:, 0], by_f0, HUES)
        return changes[:, : hues.shape[1]].flatten(0, 1), hues.flatten()

    def _lit(self, number: int, values: Tensor) -> DifferentiableLight:
        """Light of a photograph at the samples, with shared parameters `values`."""
        light = self.start.parts(values).onto(self.light)
        return light_at(number, self.views[number], light, self.points)

    def _by_shared(
        self, number: int, some: Tensor, log: Tensor, values: Tensor, index: _SharedParameters
    ) -> tuple[Tensor, Tensor]:
        """(k, 3, N) d log L of a photograph / d shared parameter, and their indices (k,).

        By the flash's offset, from finite differences; by the homography, image gradients.
        """
        indices, columns = torch.cat([index.offset, index.vignetting]), []
        for step in 1e-2 * torch.eye(len(values), dtype=values.dtype)[index.offset]:
            rendered = log_rendered(some, [self._lit(number, values + step)])[0]
            columns.append((rendered - log)[:, 0] / 1e-2)
        columns += by_vignetting(self.views[number], self.light, self.points).expand(-1, 3, -1)
        if not number:
            return torch.stack(columns), indices
        columns += [*torch.eye(3)[..., None].expand(-1, -1, log.shape[-1])]
        columns += [*-self.by_move[number][:, :, 0]] if self.by_move else []
        indices = torch.cat([indices, index.gain[number - 1], index.move[number - 1]])
        return torch.stack(columns), indices


def _homography(move: Tensor) -> Doubles:
    """(3, 3) homography identity + `move` (8,)."""
    a, b, c, d, e, f, g, h = move.tolist()
    return np.array([[1.0 + b, c, a], [e, 1.0 + f, d], [-g, -h, 1.0]])
