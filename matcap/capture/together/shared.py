"""Shared parameters: gains, flash position, vignetting and photograph registration.

A photograph that is looked up beside its place is explained by slopes that are not there, and then
nothing seems wrong. So texels may answer to every step (variable projection
[golub1973]): their numbers are eliminated from the normal equations of some of them, and only
what no texel's own numbers could explain moves anything.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.capture.together.texels import (
    GLOSS,
    NUMBERS,
    SolveSettings,
    derivatives,
    points_of,
    rendered,
    weights,
)
from matcap.capture.together.views import PieceView, SetLight, light_at
from matcap.flash.extent import OWN
from matcap.flash.registration.camera import Doubles

_LIGHT = 4  # flash's offset, vignetting
_SHARED = _LIGHT + 2  # and the level of gloss
_GAINS = 3
_MOVES = 8  # of a homography near the identity
_FOURTH = np.array([[1.0, -8.0, 0.0, 8.0, -1.0]], np.float32) / 12.0
_ROUNDING = 1e-5  # of a diagonal, by which single precision may make it indefinite


@dataclass(frozen=True)
class SharedSettings:
    """How what is shared is found; docs/notes/several.md.

    Attributes:
        steps: Gauss-Newton steps.
        counted: what a texel weighs: neighbours lie beside their truth together.
        offset: deviation of the flash's place from where it is expected, plane units.
        gloss: deviations of the mean of log F0 and of logit roughness from what was read.
        gain: deviation of a photograph's gain, log.
        separate_gain: the same where no texel of a larger exemplar is in two photographs.
        astray: deviation of a photograph's registration, plane units.
        farthest: of a step, texels.
    """

    steps: int = 3
    counted: float = 0.03
    offset: float = 0.06
    gloss: tuple[float, float] = (0.1, 1.0)
    gain: float = 1.5
    separate_gain: float = 0.03
    astray: float = 0.004
    farthest: float = 2.0


@dataclass(frozen=True)
class _Samples:
    """Some texels in all photographs; (..., 1, N) each."""

    points: Tensor
    logs: list[Tensor]
    seen: list[Tensor]
    along: list[Tensor]  # (MOVES, 3, 1, N): what a move of a photograph changes


def shared_light(
    views: Sequence[PieceView],
    numbers: Tensor,
    prior_mean: Tensor,
    spread: Tensor,
    light: SetLight,
    radiometric: bool,
    settings: SolveSettings,
    shared: SharedSettings | None = None,
) -> SetLight:
    """The light of all photographs, where they lie as they do."""
    light_fitted, _ = shared_step(
        views, numbers, prior_mean, spread, light, radiometric, settings, shared, moving=False
    )
    return light_fitted


def shared_step(
    views: Sequence[PieceView],
    numbers: Tensor,
    prior_mean: Tensor,
    spread: Tensor,
    light: SetLight,
    radiometric: bool,
    settings: SolveSettings,
    shared: SharedSettings | None = None,
    *,
    moving: bool,
    fixed: Container[int] = (),
) -> tuple[SetLight, list[Doubles]]:
    """The light of all photographs, and (3, 3) each by which they are to be looked up elsewhere.

    Args:
        views: of the piece, the first photograph, which stays where it is, first.
        numbers: (NUMBERS, H, W) of its texels so far.
        prior_mean, spread: their prior and its deviations, likewise.
        light: so far.
        radiometric: vignetting keeps its value.
        settings, shared: see there.
        moving: whether photographs may move; else all are the identity.
        fixed: numbers of photographs that stay where they are all the same.
    """
    shared = shared or SharedSettings()
    texel = views[0].extent.texel(numbers.shape[-1])
    chosen, joined = _chosen(views, settings.sampled)
    if not joined:
        shared = replace(shared, gain=shared.separate_gain)
    samples = _sampled(views, chosen, moving)
    some, prior, doubted = (each.flatten(1)[:, chosen] for each in (numbers, prior_mean, spread))
    own = _GAINS + (_MOVES if moving else 0)
    count = _SHARED + own * (len(views) - 1)
    # Offset, vignetting, gloss; then of every photograph but the first its gains and its move.
    common = [light.offset, light.vignetting, light.gloss]
    start = torch.cat([*common, torch.zeros(count - _SHARED)]).double()
    for k in range(1, len(views)):
        first = _SHARED + own * (k - 1)
        start[first : first + _GAINS] = light.gain[k]
    lost = (1e-3, 1e-3) if radiometric else light.lost
    deviation = _deviations(len(views), own, lost, fixed, shared)
    values, some = start.clone(), some.clone()
    # Gloss is expected as it was read, whatever was found since.
    start[_LIGHT:_SHARED] = 0.0
    for _ in range(shared.steps):
        system = _eliminated(views, samples, some, prior, doubted, values, light, own, settings)
        normal = shared.counted * system.normal + torch.diag(deviation**-2)
        gradient = shared.counted * system.gradient + (start - values) / deviation**2
        step = torch.linalg.solve(normal, gradient)
        if moving:
            step = _limited(step, own, shared.farthest * texel)
        values = values + step.clamp(-1.5, 1.5)
        some = some + system.texels(step)
    moves = [np.eye(3)]
    for k in range(1, len(views)):
        first = _SHARED + own * (k - 1) + _GAINS
        moves.append(_homography(values[first : first + _MOVES].numpy()) if moving else np.eye(3))
    return _light_of(values, light, own), moves


def _chosen(views: Sequence[PieceView], count: int) -> tuple[Tensor, bool]:
    """(1, count) texels by chance, of a piece larger than a photograph such as two show; and
    whether there are any.
    """
    generator = torch.Generator().manual_seed(0)
    every = views[0].log[0].numel()
    chosen = torch.randint(every, (1, count), generator=generator)
    if views[0].extent == OWN:
        return chosen, True
    shared = torch.stack([view.seen.all(0) for view in views]).sum(0) > 1
    places = shared.flatten().nonzero()[:, 0]
    return (places[chosen % len(places)], True) if len(places) else (chosen, False)


def _sampled(views: Sequence[PieceView], chosen: Tensor, moving: bool) -> _Samples:
    size = views[0].log.shape[-2:]
    texel = views[0].extent.texel(size[-1])
    points = points_of(size, extent=views[0].extent).flatten(1)[:, chosen]
    along = []
    for view in views:
        dx, dy = (
            (plane.flatten(1)[:, chosen] for plane in _gradient(view.log, texel))
            if moving
            else (
                torch.zeros(3, *chosen.shape),
                torch.zeros(3, *chosen.shape),
            )
        )
        x, y = points[0], points[1]
        radial = x * dx + y * dy
        along.append(torch.stack([dx, dx * x, dx * y, dy, dy * x, dy * y, x * radial, y * radial]))
    return _Samples(
        points,
        [view.log.flatten(1)[:, chosen] for view in views],
        [view.seen.flatten(1)[:, chosen] for view in views],
        along,
    )


def _gradient(log: Tensor, texel: float) -> tuple[Tensor, Tensor]:
    """(3, H, W) each: what log radiance gains by plane units to the right, and up.

    To fourth order: central differences halve what a weave of four texels gains, and photographs
    are then moved twice as far as they are misregistered, to and fro.
    """
    right = _FOURTH / texel
    gradients: tuple[list[NDArray[np.float32]], list[NDArray[np.float32]]] = ([], [])
    for plane in log.numpy():
        for way, kernel in zip(gradients, (right, -right.T), strict=True):
            gained = cv2.filter2D(plane, cv2.CV_32F, kernel, borderType=cv2.BORDER_REFLECT_101)
            way.append(np.asarray(gained, np.float32))
    return torch.from_numpy(np.stack(gradients[0])), torch.from_numpy(np.stack(gradients[1]))


@dataclass(frozen=True)
class _Eliminated:
    """Reduced normal equations (Schur complement) of the shared parameters, texels eliminated."""

    normal: Tensor
    gradient: Tensor
    alone: Tensor  # (N, NUMBERS) texels' step if nothing shared moves
    answer: Tensor  # (N, NUMBERS, count) what it loses by a step of what is shared

    def texels(self, step: Tensor) -> Tensor:
        """(NUMBERS, 1, N) step of texels' numbers with one of what is shared."""
        return (self.alone - self.answer @ step.float()).clamp(-0.7, 0.7).T[:, None]


def _eliminated(
    views: Sequence[PieceView],
    samples: _Samples,
    some: Tensor,
    prior: Tensor,
    spread: Tensor,
    values: Tensor,
    light: SetLight,
    own: int,
    settings: SolveSettings,
) -> _Eliminated:
    count, texels = len(values), some.shape[-1]
    precision = spread[:, 0].T.square().reciprocal()
    within = torch.diag_embed(precision)
    between = torch.zeros(texels, NUMBERS, count)
    right = precision * (prior - some)[:, 0].T
    normal = torch.zeros(count, count, dtype=torch.float64)
    gradient = torch.zeros(count, dtype=torch.float64)
    # The mean of gloss is seen through every texel's prior alone: hierarchical least squares.
    level = slice(_LIGHT, _SHARED)
    right[:, GLOSS] += precision[:, GLOSS] * values[level].float()
    between[:, GLOSS, level] = -torch.diag_embed(precision[:, GLOSS])
    normal[level, level] = torch.diag(precision[:, GLOSS].double().sum(0))
    gradient[level] = -right[:, GLOSS].double().sum(0)
    now = _light_of(values, light, own)
    for k, view in enumerate(views):
        lit = light_at(k, view, now, samples.points)
        log, own_numbers = derivatives(some, lit, settings.step)
        first = _SHARED + own * (k - 1)
        moved = values[first + _GAINS : first + own].float() if k and own > _GAINS else None
        seen_log = samples.logs[k]
        if moved is not None:
            seen_log = seen_log + torch.einsum("i,icxn->cxn", moved, samples.along[k])
        residual = seen_log - log
        weight = weights(residual, samples.seen[k], view.noise, settings)[:, 0]
        columns, places = _by_shared(view, k, samples, some, log, values, light, own, first)
        weighted = own_numbers * weight
        within += torch.einsum("icn,jcn->nij", weighted, own_numbers)
        right += torch.einsum("icn,cn->ni", weighted, residual[:, 0])
        between[:, :, places] += torch.einsum("icn,jcn->nij", weighted, columns)
        wide = (columns * weight).double()
        normal[places[:, None], places] += torch.einsum("icn,jcn->ij", wide, columns.double())
        gradient[places] += torch.einsum("icn,cn->i", wide, residual[:, 0].double())
    solved = texels_solved(within, torch.cat([right[..., None], between], dim=-1))
    alone, answer = solved[..., 0], solved[..., 1:]
    return _Eliminated(
        normal - torch.einsum("nij,nik->jk", between.double(), answer.double()),
        gradient - torch.einsum("nij,ni->j", between.double(), alone.double()),
        alone,
        answer,
    )


def texels_solved(within: Tensor, sides: Tensor) -> Tensor:
    """(N, NUMBERS, k) solutions of every texel's normal equations (N, NUMBERS, NUMBERS).

    Some are singular in single precision: their solution is set to 0, where a step of any size
    would propagate into the shared parameters.

    Args:
        within: symmetric, positive but for rounding.
        sides: (N, NUMBERS, k) right-hand sides.
    """
    damped = within + torch.diag_embed(_ROUNDING * within.diagonal(dim1=-2, dim2=-1))
    factor, failed = torch.linalg.cholesky_ex(damped)
    solution = torch.cholesky_solve(sides, factor)
    sound = (failed == 0)[:, None, None] & torch.isfinite(solution).all(-2, keepdim=True)
    return torch.where(sound, solution, 0.0)


def _by_shared(
    view: PieceView,
    k: int,
    samples: _Samples,
    some: Tensor,
    log: Tensor,
    values: Tensor,
    light: SetLight,
    own: int,
    first: int,
) -> tuple[Tensor, Tensor]:
    """(columns, 3, N) what residuals lose by what is shared, and which of it."""
    columns = []
    for index in range(_LIGHT):
        other = values.clone()
        other[index] += 1e-2
        lit = light_at(k, view, _light_of(other, light, own), samples.points)
        columns.append((rendered(some, [lit])[0].log() - log)[:, 0] / 1e-2)
    places = list(range(_LIGHT))
    if k:
        for channel in range(_GAINS):
            gain = torch.zeros_like(columns[0])
            gain[channel] = 1.0
            columns.append(gain)
        if own > _GAINS:
            columns += list(-samples.along[k][:, :, 0])
        places += range(first, first + own)
    return torch.stack(columns), torch.tensor(places)


def _deviations(
    photographs: int,
    own: int,
    lost: tuple[float, float],
    fixed: Container[int],
    shared: SharedSettings,
) -> Tensor:
    whole = [shared.offset, shared.offset, *lost, *shared.gloss]
    for number in range(1, photographs):
        moves = 1e-9 if number in fixed else shared.astray
        whole += [shared.gain] * _GAINS + [moves] * (own - _GAINS)
    return torch.tensor(whole, dtype=torch.float64)


def _limited(step: Tensor, own: int, most: float) -> Tensor:
    """A step by which no photograph moves farther."""
    step = step.clone()
    for first in range(_SHARED + _GAINS, len(step), own):
        step[first : first + _MOVES] = step[first : first + _MOVES].clamp(-most, most)
    return step


def _homography(move: NDArray[np.float64]) -> Doubles:
    a, b, c, d, e, f, g, h = move
    return np.array([[1.0 + b, c, a], [e, 1.0 + f, d], [-g, -h, 1.0]])


def _light_of(values: Tensor, light: SetLight, own: int) -> SetLight:
    gains = values[_SHARED:].reshape(-1, own)[:, :_GAINS]
    gain = torch.cat([torch.zeros(1, 3), gains.float()])
    offset, vignetting, gloss = values[:_SHARED].float().split(2)
    return replace(light, offset=offset, vignetting=vignetting, gloss=gloss, gain=gain)
