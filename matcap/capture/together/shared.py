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
from torch import Tensor

from matcap.capture.registration.camera import Doubles
from matcap.capture.together.ambient_light import AmbientLight
from matcap.capture.together.texels import (
    GLOSS,
    PARAMETERS,
    ParameterPrior,
    derivatives,
    jacobian,
    points_of,
    rendered,
    solved_in_place,
    weights,
)
from matcap.capture.together.views import ResampledView, SetLight, light_at
from matcap.flash.extent import OWN
from matcap.flash.light import FlashLight

_OFFSET, _VIGNETTING, _GLOSS = slice(0, 2), slice(2, 4), slice(4, 6)
_LIGHT = slice(0, 4)  # offset and vignetting
_SHARED, _GAINS, _MOVES = 6, 3, 8  # numbers of parameters: common, gains of each, homography
# Fourth-order derivative, twelvefold: weights of texels this far away.
_FOURTH = ((-2, 1.0), (-1, -8.0), (1, 8.0), (2, -1.0))
_ROUNDING = 1e-5  # damping of the diagonal against rounding in single precision


# Estimation of the shared parameters; docs/notes/several.md.
SAMPLED = 4000  # texels to which they are fitted
_STEPS = 3  # Gauss-Newton steps
_COUNTED = 0.03  # weight of a texel, below 1 as errors of neighbouring texels are correlated
_FARTHEST = 2.0  # largest displacement of a photograph in a step, texels
# Prior standard deviations: of the flash position and of a photograph's registration, plane units;
# of the change of mean log F0 and mean logit roughness from the prediction, and the same where one
# photograph alone has flash, which the prediction has already used; of the log gain of a
# photograph, and the same if no texel of a mosaic is in two photographs.
_OFFSET_DEVIATION, _ASTRAY = 0.06, 0.004
# Largest distance of the flash, along each axis, from where the coarse fit has it, plane units:
# shading that is not the flash's (folds of cloth, room light) moved it beyond any phone.
_FARTHEST_FLASH = 0.15
_GLOSS_DEVIATION, _KNOWN_GLOSS = (0.1, 1.0), (0.01, 0.01)
_GAIN, _SEPARATE_GAIN = 1.5, 0.03


@dataclass(frozen=True)
class _Samples:
    """N sampled texels in all photographs; (..., 1, N) each."""

    points: Tensor
    logs: list[Tensor]
    seen: list[Tensor]
    along: list[Tensor]  # (_MOVES, 3, 1, N): d log L / d homography parameter


def shared_step(
    views: Sequence[ResampledView],
    parameters: Tensor,
    prior: ParameterPrior,
    light: SetLight,
    sampled: int = SAMPLED,
    moved: Collection[int] = (),
) -> tuple[SetLight, list[Doubles]]:
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
    alone = sum(view.ambient is None for view in views) == 1
    chosen, joined = _chosen(views, sampled)
    deviations = (
        _KNOWN_GLOSS if alone else _GLOSS_DEVIATION,
        _GAIN if joined else _SEPARATE_GAIN,
    )
    layout = _Layout(len(views), moving=bool(moved))
    some, mean, deviation = (
        each.flatten(1)[:, chosen] for each in (parameters, prior.mean, prior.deviation)
    )
    problem = _SharedFit(
        views,
        _sampled(views, chosen, layout.moving),
        ParameterPrior(mean, deviation),
        light,
        layout,
    )
    expected, tight = layout.vector(light), layout.deviations(light, moved, *deviations)
    values = expected.clone()
    # Prior means of gloss and flash offset are always the prediction's and the coarse fit's.
    expected[_GLOSS], expected[_OFFSET] = 0.0, light.coarse_offset.double()
    nearest, farthest_flash = (expected[_OFFSET] + side * _FARTHEST_FLASH for side in (-1, 1))
    farthest = _FARTHEST * views[0].extent.texel(parameters.shape[-1])
    for _ in range(_STEPS):
        system = problem.eliminated(some, values)
        normal = _COUNTED * system.normal + torch.diag(tight**-2)
        gradient = _COUNTED * system.gradient + (expected - values) / tight**2
        step = layout.limited(torch.linalg.solve(normal, gradient), farthest)
        values = values + step.clamp(-1.5, 1.5)
        values[_OFFSET] = values[_OFFSET].clamp(nearest, farthest_flash)
        some = some + system.texels(step)
    moves = [_homography(values[layout.move(k)]) for k in range(1, len(views))]
    return layout.light(values, light), [np.eye(3), *moves]


@dataclass(frozen=True)
class _Layout:
    """Indices of the shared parameters in their vector.

    Flash offset (2), vignetting (2), gloss (2); then for every photograph but the first its log
    gains (3) and, if registration is solved for (`moving`), its homography (8).
    """

    photographs: int
    moving: bool

    def own(self, number: int) -> slice:
        """All parameters of photograph `number`, at least 1."""
        size = _GAINS + self.moving * _MOVES
        return slice(_SHARED + size * (number - 1), _SHARED + size * number)

    def gains(self, number: int) -> slice:
        """Log gains of a photograph."""
        first = self.own(number).start
        return slice(first, first + _GAINS)

    def move(self, number: int) -> slice:
        """Homography of a photograph; empty if registration is not solved for."""
        return slice(self.gains(number).stop, self.own(number).stop)

    def vector(self, light: SetLight) -> Tensor:
        """Parameter vector of a light, with zero change of registration."""
        vector = torch.zeros(self.own(self.photographs - 1).stop, dtype=torch.float64)
        vector[_OFFSET], vector[_VIGNETTING], vector[_GLOSS] = (
            each.double() for each in (light.offset, light.vignetting, light.gloss)
        )
        for k in range(1, self.photographs):
            vector[self.gains(k)] = light.gain[k].double()
        return vector

    def light(self, vector: Tensor, light: SetLight) -> SetLight:
        """`light` with the parameters of `vector`, the inverse of vector()."""
        gains = [vector[self.gains(k)] for k in range(1, self.photographs)]
        gain = torch.stack([torch.zeros(3), *(each.float() for each in gains)])
        offset, vignetting, gloss = (
            vector[part].float() for part in (_OFFSET, _VIGNETTING, _GLOSS)
        )
        return replace(light, offset=offset, vignetting=vignetting, gloss=gloss, gain=gain)

    def deviations(
        self, light: SetLight, moved: Collection[int], gloss: tuple[float, float], gain: float
    ) -> Tensor:
        """Prior standard deviation of each shared parameter."""
        whole = [_OFFSET_DEVIATION, _OFFSET_DEVIATION, *light.lost, *gloss]
        for number in range(1, self.photographs):
            moves = _ASTRAY if number in moved else 1e-9
            whole += [gain] * _GAINS + [moves] * (self.moving * _MOVES)
        return torch.tensor(whole, dtype=torch.float64)

    def limited(self, step: Tensor, most: float) -> Tensor:
        """The step scaled down so that no photograph moves farther than `most`."""
        step = step.clone()
        for k in range(1, self.photographs):
            step[self.move(k)] = step[self.move(k)].clamp(-most, most)
        return step


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


def _sampled(views: Sequence[ResampledView], chosen: Tensor, moving: bool) -> _Samples:
    """All photographs at the `chosen` texels, with image gradients if `moving`."""
    size = views[0].log.shape[-2:]
    texel = views[0].extent.texel(size[-1])
    points = points_of(size, extent=views[0].extent).flatten(1)[:, chosen]
    along = []
    for view in views:
        dx, dy = _gradient(view.log, chosen, texel) if moving else torch.zeros(2, 3, *chosen.shape)
        x, y = points[0], points[1]
        radial = x * dx + y * dy
        along.append(torch.stack([dx, dx * x, dx * y, dy, dy * x, dy * y, x * radial, y * radial]))
    return _Samples(
        points,
        [view.log.flatten(1)[:, chosen] for view in views],
        [view.seen.flatten(1)[:, chosen] for view in views],
        along,
    )


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
    for off, weight in _FOURTH:
        dx += weight * log[:, row, mirrored(column + off, width)]
        dy += weight * log[:, mirrored(row - off, height), column]
    spacing = 12.0 * texel
    return dx / spacing, dy / spacing


@dataclass(frozen=True)
class _Eliminated:
    """Reduced normal equations (Schur complement) of the shared parameters, texels eliminated."""

    normal: Tensor
    gradient: Tensor
    alone: Tensor  # (PARAMETERS, N) texels' step at fixed shared parameters
    answer: Tensor  # (PARAMETERS, count, N) minus its derivative by the shared parameters' step

    def texels(self, step: Tensor) -> Tensor:
        """(PARAMETERS, 1, N) texel parameters' step by back-substitution of the shared `step`."""
        moved = (self.answer * step.float()[:, None]).sum(1)
        return (self.alone - moved).clamp(-0.7, 0.7)[:, None]


@dataclass(frozen=True)
class _SharedFit:
    """The least-squares problem at the sampled texels.

    Attributes:
        views: photographs on the whole grid.
        samples: the sampled texels in each.
        prior: of the sampled texels' parameters.
        light: gives the properties that are not fitted.
        layout: of the shared parameters.
    """

    views: Sequence[ResampledView]
    samples: _Samples
    prior: ParameterPrior
    light: SetLight
    layout: _Layout

    def eliminated(self, some: Tensor, values: Tensor) -> _Eliminated:
        """Reduced normal equations at texel parameters (PARAMETERS, 1, N) and shared `values`."""
        texels, count = some.shape[-1], len(values)
        precision = self.prior.precision[:, 0]
        within = torch.diag_embed(precision.T).movedim(0, -1).contiguous()
        between = torch.zeros(PARAMETERS, count, texels)
        right = precision * (self.prior.mean - some)[:, 0]
        normal = torch.zeros(count, count, dtype=torch.float64)
        gradient = torch.zeros(count, dtype=torch.float64)
        # The mean of gloss acts only through the texels' priors: hierarchical least squares.
        right[GLOSS] += precision[GLOSS] * values[_GLOSS].float()[:, None]
        between[GLOSS, _GLOSS] = -torch.diag_embed(precision[GLOSS].T).movedim(0, -1)
        normal[_GLOSS, _GLOSS] = torch.diag(precision[GLOSS].double().sum(1))
        gradient[_GLOSS] = -right[GLOSS].double().sum(1)
        lights = [self._lit(k, values) for k in range(len(self.views))]
        shaded = derivatives(some, lights)
        for (k, view), (log, *shown) in zip(enumerate(self.views), shaded, strict=True):
            own = jacobian(*shown)
            seen_log = self.samples.logs[k]
            if k and self.layout.moving:
                move = values[self.layout.move(k)].float()
                seen_log = seen_log + torch.einsum("i,icxn->cxn", move, self.samples.along[k])
            residual = seen_log - log
            weight = weights(residual, self.samples.seen[k], view.noise)[:, 0]
            columns, places = self._by_shared(k, some, log, values)
            weighted = own * weight
            within += (weighted[:, None] * own).sum(2)
            right += (weighted * residual[:, 0]).sum(1)
            between[:, places] += (weighted[:, None] * columns).sum(2)
            wide = (columns * weight).double().flatten(1)
            normal[places[:, None], places] += wide @ columns.double().flatten(1).T
            gradient[places] += wide @ residual.double().flatten()
        solved = texels_solved(within, torch.cat([right[:, None], between], dim=1))
        lost = (between.double() @ solved.double().mT).sum(0)
        return _Eliminated(normal - lost[:, 1:], gradient - lost[:, 0], solved[:, 0], solved[:, 1:])

    def _lit(self, number: int, values: Tensor) -> FlashLight | AmbientLight:
        """Light of a photograph at the samples, with shared parameters `values`."""
        light = self.layout.light(values, self.light)
        return light_at(number, self.views[number], light, self.samples.points)

    def _by_shared(
        self, number: int, some: Tensor, log: Tensor, values: Tensor
    ) -> tuple[Tensor, Tensor]:
        """(columns, 3, N) d log L of a photograph / d shared parameter, and their indices."""
        columns, places = [], list(range(*_LIGHT.indices(len(values))))
        for index in places:
            other = values.clone()
            other[index] += 1e-2
            shown = rendered(some, [self._lit(number, other)])[0].log()
            columns.append((shown - log)[:, 0] / 1e-2)
        if number:
            columns += [*torch.eye(_GAINS)[..., None].expand(-1, -1, log.shape[-1])]
            if self.layout.moving:
                columns += [*-self.samples.along[number][:, :, 0]]
            own = self.layout.own(number)
            places += range(own.start, own.stop)
        return torch.stack(columns), torch.tensor(places)


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
    """(3, 3) homography identity + `move` (8,); the identity if `move` is empty."""
    if not len(move):
        return np.eye(3)
    a, b, c, d, e, f, g, h = move.tolist()
    return np.array([[1.0 + b, c, a], [e, 1.0 + f, d], [-g, -h, 1.0]])
