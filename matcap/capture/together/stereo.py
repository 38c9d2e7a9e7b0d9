"""Where slopes begin: photometric stereo with near lights (Woodham 1980)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from matcap.capture.together.texels import ALBEDO, SLOPES, SolveSettings, cost_of, points_of
from matcap.capture.together.views import PieceView, SetLight, light_at, strips


def stereo(
    views: Sequence[PieceView], numbers: Tensor, light: SetLight, settings: SolveSettings
) -> Tensor:
    """Numbers whose slopes and albedo begin at photometric stereo, where that is nearer.

    Reweighted least squares for albedo times normal, of grey radiance over each photograph's
    irradiance; what is brighter than it lets expect is a highlight, what is darker a shadow.
    """
    found = numbers.clone()
    for rows in strips(numbers.shape[1], settings.rows):
        part = slice(None), rows
        points = points_of(numbers.shape[-2:], rows)
        lights = [light_at(k, view, light, points) for k, view in enumerate(views)]
        seen = torch.stack([view.seen[:, rows].all(0) for view in views]).float()
        grey = torch.stack(
            [
                (view.log[:, rows].exp() / lit.power).mean(0)
                for view, lit in zip(views, lights, strict=True)
            ]
        )
        towards = torch.stack([lit.to_light for lit in lights])
        slopes, albedo = _lambert(grey, towards, seen)
        start = numbers[part].clone()
        start[SLOPES] = slopes.clamp(-settings.steepest, settings.steepest)
        change = (albedo * math.pi).clamp(1e-3, 0.98).log() - start[ALBEDO].exp().mean(0).log()
        start[ALBEDO] = start[ALBEDO] + change
        costs = [cost_of(views, rows, each, lights, settings) for each in (numbers[part], start)]
        enough = (seen.sum(0) >= 3.0) & (costs[1] < costs[0])
        found[part] = torch.where(enough, start, numbers[part])
    return found


def _lambert(grey: Tensor, towards: Tensor, seen: Tensor) -> tuple[Tensor, Tensor]:
    """(2, h, w) slopes and (h, w) albedo over pi of K grey reflectances (K, h, w)."""
    weight = seen + 1e-4
    answer = torch.zeros(3, *grey.shape[1:])
    for _ in range(5):
        matrix = torch.einsum("khw,kihw,kjhw->hwij", weight, towards, towards)
        ridge = 1e-3 * matrix.diagonal(dim1=2, dim2=3).sum(-1) + 1e-6
        lean = torch.tensor([1.0, 1.0, 0.02])
        matrix = matrix + ridge[..., None, None] * torch.diag(lean)
        right = torch.einsum("khw,kihw,khw->hwi", weight, towards, grey)
        answer = torch.linalg.solve(matrix, right).permute(2, 0, 1)
        left = grey - torch.einsum("ihw,kihw->khw", answer, towards).clamp_min(0.0)
        scale = left.abs().median(0).values + 0.03 * answer.norm(dim=0) + 1e-6
        bright, dark = (left / scale).clamp_min(0.0), (left / scale).clamp_max(0.0)
        weight = seen / (1.0 + 2.0 * bright.square() + 0.3 * dark.square()) + 1e-4
    length = answer.norm(dim=0)
    up = answer[2].clamp_min(0.15 * length + 1e-6)
    return -answer[:2] / up, length
