"""Shared parameters: gains, flash position, vignetting and photograph registration.

Misregistration can be absorbed by spurious slopes and then leaves no residual. The shared
parameters are therefore solved by variable projection [golub1973]: at a sample of texels, the
texels' own parameters are eliminated from the normal equations (Schur complement), so that only
residuals they cannot explain change the shared ones.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.capture.multiview.texels import (
    GLOSS,
    PARAMETERS,
    ParameterPrior,
    derivatives,
    jacobian,
    log_rendered,
    points_of,
    solved_in_place,
    weights,
)
from matcap.capture.multiview.views import FlashOrAmbient, ResampledView, SharedLight, light_at
from matcap.capture.registration.camera import Doubles
from matcap.flash.extent import OWN

# The vector of shared parameters: flash offset (2), vignetting (2), gloss (2); then, for every
# photograph but the first, its log gains (3) and, if any is moved, its homography (8).
_OFFSET, _VIGNETTING, _GLOSS = slice(0, 2), slice(2, 4), slice(4, 6)
_LIGHT = slice(0, 4)  # offset and vignetting, which change the radiance of all photographs
_COMMON, _GAINS, _MOVES = 6, 3, 8  # numbers of parameters: of all, and of one photograph
# Fourth-order derivative, twelvefold: weights of texels this far away.
_FOURTH = ((-2, 1.0), (-1, -8.0), (1, 8.0), (2, -1.0))
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
# Prior standard deviations of the change of mean log F0 and mean logit roughness from the
# prediction; and where one photograph alone has flash, which the prediction has already used.
_GLOSS_DEVIATION, _KNOWN_GLOSS = (0.1, 1.0), (0.01, 0.01)
# Prior standard deviation of the log gain of a photograph; and if no texel of a mosaic is in two.
_GAIN, _SEPARATE_GAIN = 1.5, 0.03


def shared_step(
    views: Sequence[ResampledView],
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
        prior: of the parameters.
        light: current estimate.
        sampled: texels to which the parameters are fitted.
        moved: indices of photographs to register; the others get the identity.
    """
    chosen, joined = _chosen(views, sampled)
    some, mean, deviation = (
        each.flatten(1)[:, chosen] for each in (parameters, prior.mean, prior.deviation)
    )
    moving = bool(moved)
    problem = _SharedFit.of(views, chosen, ParameterPrior(mean, deviation), light, moving)
    values, deviations = _vector(light, moving), _deviations(views, light, moved, joined)
    expected = values.clone()
    # Prior means of gloss and flash offset are always the prediction's and the coarse fit's.
    expected[_GLOSS], expected[_OFFSET] = 0.0, light.coarse_offset.double()
    nearest, farthest = (expected[_OFFSET] + side * _LARGEST_OFFSET for side in (-1, 1))
    largest_move = _LARGEST_MOVE * views[0].extent.texel(parameters.shape[-1])
    for _ in range(_STEPS):
        matrix, right, texel_step, by_shared = problem.equations(some, values).reduced()
        matrix = _COUNTED * matrix + torch.diag(deviations**-2)
        right = _COUNTED * right + (expected - values) / deviations**2
        step = torch.linalg.solve(matrix, right)
        _homographies(step, moving).clamp_(-largest_move, largest_move)
        values = values + step.clamp(-1.5, 1.5)
        values[_OFFSET] = values[_OFFSET].clamp(nearest, farthest)
        texel_step = texel_step - (by_shared * step.float()[:, None]).sum(1)
        some = some + texel_step.clamp(-0.7, 0.7)[:, None]
    moves = _homographies(values, moving) if moving else torch.zeros(0, _MOVES)
    unmoved = [np.eye(3)] * (len(views) - len(moves))
    return _with_vector(light, values, moving), [*unmoved, *map(_homography, moves)]


def _vector(light: SharedLight, moving: bool) -> Tensor:
    """Shared parameters of a light, with zero change of registration."""
    by_photograph = F.pad(light.gain[1:], (0, _MOVES * moving)).flatten()
    return torch.cat([light.offset, light.vignetting, light.gloss, by_photograph]).double()


def _by_photograph(vector: Tensor, moving: bool) -> Tensor:
    """(photographs - 1, _GAINS or _GAINS + _MOVES) view of the parameters of one photograph."""
    return vector[_COMMON:].view(-1, _GAINS + _MOVES * moving)


def _gains(vector: Tensor, moving: bool) -> Tensor:
    """(photographs - 1, _GAINS) view of the log gains."""
    return _by_photograph(vector, moving)[:, :_GAINS]


def _homographies(vector: Tensor, moving: bool) -> Tensor:
    """(photographs - 1, 0 or _MOVES) view of the changes of registration."""
    return _by_photograph(vector, moving)[:, _GAINS:]


def _with_vector(light: SharedLight, vector: Tensor, moving: bool) -> SharedLight:
    """`light` with the parameters of `vector`, the inverse of _vector."""
    single = vector.float()
    return replace(
        light,
        offset=single[_OFFSET],
        vignetting=single[_VIGNETTING],
        gloss=single[_GLOSS],
        gain=F.pad(_gains(single, moving), (0, 0, 1, 0)),
    )


def _deviations(
    views: Sequence[ResampledView], light: SharedLight, moved: Collection[int], joined: bool
) -> Tensor:
    """Prior standard deviation of each shared parameter."""
    one_flash = sum(view.flash for view in views) == 1
    gain = _GAIN if joined else _SEPARATE_GAIN
    deviations = [_OFFSET_DEVIATION, _OFFSET_DEVIATION, *light.vignetting_deviation]
    deviations += _KNOWN_GLOSS if one_flash else _GLOSS_DEVIATION
    for number in range(1, len(views)):
        moves = _MISREGISTRATION if number in moved else 1e-9
        deviations += [gain] * _GAINS + [moves] * (bool(moved) * _MOVES)
    return torch.tensor(deviations, dtype=torch.float64)


def _chosen(views: Sequence[ResampledView], count: int) -> tuple[Tensor, bool]:
    """(1, count) random texel indices, and whether two photographs show a common texel.

    In a mosaic, only texels that two photographs show are drawn, if there are any.
    """
    generator = torch.Generator().manual_seed(0)
    every = views[0].log[0].numel()
    chosen = torch.randint(every, (1, count), generator=generator)
    if views[0].extent == OWN:
        return chosen, True
    shared = torch.stack([view.seen.all(0) for view in views]).sum(0) > 1
    places = shared.flatten().nonzero()[:, 0]
    return (places[chosen % len(places)], True) if len(places) else (chosen, False)


def _gradient(log: Tensor, chosen: Tensor, texel: float) -> tuple[Tensor, Tensor]:
    """(3, 1, N) each: d log L / dx (right) and d log L / dy (up), per plane unit.

    Fourth order: second-order differences underestimate the gradient of a weave of period four
    texels, and registration steps then overshoot and oscillate.

    Args:
        log: (3, H, W) log radiance.
        chosen: (1, N) indices of texels.
        texel: side of a texel, plane units.
    """
    height, width = log.shape[1:]
    row, column = chosen // width, chosen % width

    def mirrored(index: Tensor, side: int) -> Tensor:
        return side - 1 - (side - 1 - index.abs()).abs()

    dx, dy = torch.zeros(2, 3, *chosen.shape)
    for offset, weight in _FOURTH:
        dx += weight * log[:, row, mirrored(column + offset, width)]
        dy += weight * log[:, mirrored(row - offset, height), column]
    spacing = 12.0 * texel
    return dx / spacing, dy / spacing


@dataclass(frozen=True)
class _Equations:
    """Normal equations of N texels' parameters t and the shared ones s, modified in place.

    For each texel A dt + B ds = a, and for all, C ds + sum over texels of B^T dt = c.
    """

    texels: Tensor
    """(PARAMETERS, PARAMETERS, N) A."""
    coupling: Tensor
    """(PARAMETERS, n, N) B."""
    right: Tensor
    """(PARAMETERS, N) a."""
    shared: Tensor
    """(n, n) C, double precision."""
    shared_right: Tensor
    """(n,) c, double precision."""

    @staticmethod
    def of_prior(prior: ParameterPrior, some: Tensor, values: Tensor) -> _Equations:
        """Equations by the texels' prior, whose means of gloss are shared: hierarchical.

        Args:
            prior: of the texels, (PARAMETERS, 1, N).
            some: (PARAMETERS, 1, N) texel parameters.
            values: (n,) shared parameters.
        """
        precision, count = prior.precision[:, 0], len(values)
        right = precision * (prior.mean - some)[:, 0]
        right[GLOSS] += precision[GLOSS] * values[_GLOSS].float()[:, None]
        coupling = torch.zeros(PARAMETERS, count, some.shape[-1])
        coupling[GLOSS, _GLOSS] = -torch.diag_embed(precision[GLOSS].T).movedim(0, -1)
        shared = torch.zeros(count, count, dtype=torch.float64)
        shared[_GLOSS, _GLOSS] = torch.diag(precision[GLOSS].double().sum(1))
        shared_right = torch.zeros(count, dtype=torch.float64)
        shared_right[_GLOSS] = -right[GLOSS].double().sum(1)
        texels = torch.diag_embed(precision.T).movedim(0, -1).contiguous()
        return _Equations(texels, coupling, right, shared, shared_right)

    def add(
        self, by_texel: Tensor, by_shared: Tensor, indices: Tensor, weight: Tensor, residual: Tensor
    ) -> None:
        """Add the equations of a photograph.

        Args:
            by_texel: (PARAMETERS, 3, N) derivatives of log radiance by the texel's parameters.
            by_shared: (k, 3, N) derivatives by some shared parameters.
            indices: (k,) of these.
            weight, residual: (3, N) of log radiance.
        """
        weighted = by_texel * weight
        self.texels.add_((weighted[:, None] * by_texel).sum(2))
        self.right.add_((weighted * residual).sum(1))
        self.coupling[:, indices] += (weighted[:, None] * by_shared).sum(2)
        weighted_shared = (by_shared * weight).double().flatten(1)
        self.shared[indices[:, None], indices] += weighted_shared @ by_shared.double().flatten(1).T
        self.shared_right[indices] += weighted_shared @ residual.double().flatten()

    def reduced(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Equations of the shared parameters, texels eliminated (Schur complement).

            (C - sum B^T A^-1 B) ds = c - sum B^T A^-1 a,    dt = A^-1 a - A^-1 B ds.

        Returns:
            (n, n) matrix and (n,) right-hand side; (PARAMETERS, N) A^-1 a; (PARAMETERS, n, N)
            A^-1 B.
        """
        sides = torch.cat([self.right[:, None], self.coupling], dim=1)
        solved = texels_solved(self.texels, sides)
        eliminated = (self.coupling.double() @ solved.double().mT).sum(0)
        matrix, right = self.shared - eliminated[:, 1:], self.shared_right - eliminated[:, 0]
        return matrix, right, solved[:, 0], solved[:, 1:]


@dataclass(frozen=True)
class _SharedFit:
    """The least-squares problem at N sampled texels."""

    views: Sequence[ResampledView]
    """The photographs at these texels, (3, 1, N)."""
    points: Tensor
    """(3, 1, N) plane points."""
    by_move: Sequence[Tensor]
    """(_MOVES, 3, 1, N) d log L / d homography of each photograph; empty if none is moved."""
    prior: ParameterPrior
    """Prior of the sampled texels' parameters."""
    light: SharedLight
    """Gives the properties that are not fitted."""

    @staticmethod
    def of(
        views: Sequence[ResampledView],
        chosen: Tensor,
        prior: ParameterPrior,
        light: SharedLight,
        moving: bool,
    ) -> _SharedFit:
        """The problem at the texels `chosen` (1, N), with image gradients if `moving`."""
        size, extent = views[0].log.shape[-2:], views[0].extent
        points = points_of(size, extent=extent).flatten(1)[:, chosen]
        by_move, (x, y, _) = [], points
        for view in views if moving else ():
            dx, dy = _gradient(view.log, chosen, extent.texel(size[-1]))
            radial = x * dx + y * dy
            moves = [dx, dx * x, dx * y, dy, dy * x, dy * y, x * radial, y * radial]
            by_move.append(torch.stack(moves))
        few = [
            replace(v, log=v.log.flatten(1)[:, chosen], seen=v.seen.flatten(1)[:, chosen])
            for v in views
        ]
        return _SharedFit(few, points, by_move, prior, light)

    def equations(self, some: Tensor, values: Tensor) -> _Equations:
        """Normal equations at texel parameters (PARAMETERS, 1, N) and shared ones (n,)."""
        equations = _Equations.of_prior(self.prior, some, values)
        lights = [self._lit(number, values) for number in range(len(self.views))]
        shaded = derivatives(some, lights)
        for (number, view), (log, *by_texel) in zip(enumerate(self.views), shaded, strict=True):
            residual = view.log - log
            if number and self.by_move:
                move = _homographies(values, True)[number - 1].float()
                residual = view.log + torch.einsum("i,icxn->cxn", move, self.by_move[number]) - log
            weight = weights(residual, view.seen, view.noise)[:, 0]
            by_shared, indices = self._by_shared(number, some, log, values)
            equations.add(jacobian(*by_texel), by_shared, indices, weight, residual[:, 0])
        return equations

    def _lit(self, number: int, values: Tensor) -> FlashOrAmbient:
        """Light of a photograph at the samples, with shared parameters `values`."""
        light = _with_vector(self.light, values, bool(self.by_move))
        return light_at(number, self.views[number], light, self.points)

    def _by_shared(
        self, number: int, some: Tensor, log: Tensor, values: Tensor
    ) -> tuple[Tensor, Tensor]:
        """(k, 3, N) d log L of a photograph / d shared parameter, and their indices (k,).

        By the light, from finite differences; by a gain, 1; by the homography, image gradients.
        """
        indices, columns = torch.arange(len(values)), []
        for step in 1e-2 * torch.eye(len(values), dtype=values.dtype)[_LIGHT]:
            rendered = log_rendered(some, [self._lit(number, values + step)])[0]
            columns.append((rendered - log)[:, 0] / 1e-2)
        if not number:
            return torch.stack(columns), indices[_LIGHT]
        columns += [*torch.eye(_GAINS)[..., None].expand(-1, -1, log.shape[-1])]
        columns += [*-self.by_move[number][:, :, 0]] if self.by_move else []
        own = _by_photograph(indices, bool(self.by_move))[number - 1]
        return torch.stack(columns), torch.cat([indices[_LIGHT], own])


def texels_solved(within: Tensor, sides: Tensor) -> Tensor:
    """(PARAMETERS, k, N) solutions of N texels' normal equations (PARAMETERS, PARAMETERS, N).

    Solutions of equations that are singular in single precision are set to 0, as an arbitrary step
    would propagate into the shared parameters.

    Args:
        within: symmetric, positive definite up to rounding.
        sides: (PARAMETERS, k, N) right-hand sides.
    """
    system = torch.cat([within, sides.movedim(1, 0)])
    system.diagonal().mul_(1.0 + _ROUNDING)
    return solved_in_place(system).nan_to_num(0.0, 0.0, 0.0)


def _homography(move: Tensor) -> Doubles:
    """(3, 3) homography identity + `move` (8,)."""
    a, b, c, d, e, f, g, h = move.tolist()
    return np.array([[1.0 + b, c, a], [e, 1.0 + f, d], [-g, -h, 1.0]])
