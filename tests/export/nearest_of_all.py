"""What no texture mends: `python tests/export/nearest_of_all.py [MATERIAL.matcap ...]`.

For each material (by default the metals of metals.py) the least residual that a target's shading
can have whatever is written: every texel has the diffuse albedo, F0 by channel and roughness that
leave the least sum of absolute differences over surface.DIRECTIONS. Radiance is
linear in albedo and F0 where roughness is given, so each channel is a fit of two numbers, by
reweighted least squares, over a grid of roughness. A metallic form says less: none is nearer.
"""

import sys
from pathlib import Path

import torch
from metals import metals
from target_surfaces import every, of_maps

from matcap.export.shading import Geometry, TargetShading, diffuse_lobe, specular_lobe
from matcap.export.surface import DIRECTIONS
from matcap.field.opened import open_tile

SHADINGS = {
    "matcap": TargetShading(),
    "Unreal, Default Lit": TargetShading(masking="hammon", fading=True),
}
TEXELS = 16  # a side
ROUGHNESS = torch.linspace(-0.35, 0.35, 29, dtype=torch.float64).exp()  # of the true one
ROUNDS = 30  # of reweighting
LEAST = 1e-7  # radiance: a difference below counts as its square


def least_residual(maps, shading) -> float:
    """Share of all light that differs, where every texel is as near as it can be."""
    true = every(of_maps(maps), max(1, maps.size[0] // TEXELS))
    meant = torch.stack([true.shine(*pair) for pair in DIRECTIONS])
    best = torch.full(meant.shape[-2:], torch.inf, dtype=torch.float64)
    for factor in ROUGHNESS:
        roughness = (true.roughness * factor).clamp(0.0, 1.0)
        best = torch.minimum(best, _off(true, meant, shading, roughness))
    return float(best.sum() / meant.sum())


def _off(true, meant, shading, roughness):
    """(H, W) least sum of absolute differences, roughness given."""
    one = torch.ones_like(true.roughness)
    columns = []
    for pair in DIRECTIONS:
        at = Geometry.of(true.normal, *pair)
        lit = at.light * at.above
        lobes = [specular_lobe(shading, at, f0, 1.0, roughness) for f0 in (0.1 * one, 0.6 * one)]
        slope = (lobes[1] - lobes[0]) / 0.5
        edge = lobes[0] - 0.1 * slope  # of F0 = 0, were it not fading
        columns.append([v * lit for v in (diffuse_lobe(shading, at, roughness, None), slope, edge)])
    diffuse, slope, edge = (torch.stack(part) for part in zip(*columns, strict=True))
    aim = meant - edge
    weight = torch.ones_like(meant)
    for _ in range(ROUNDS):
        dd, ds, ss = (
            (weight * a * b).sum(0)
            for a, b in ((diffuse, diffuse), (diffuse, slope), (slope, slope))
        )
        dy, sy = (weight * diffuse * aim).sum(0), (weight * slope * aim).sum(0)
        apart = (dd * ss - ds * ds).clamp_min(1e-18)
        albedo, f0 = (ss * dy - ds * sy) / apart, (dd * sy - ds * dy) / apart
        alone = sy / ss.clamp_min(1e-18)
        f0, albedo = torch.where(albedo < 0.0, alone, f0), albedo.clamp_min(0.0)
        residual = aim - albedo * diffuse - f0 * slope
        weight = 1.0 / residual.abs().clamp_min(LEAST)
    return residual.abs().sum(0).sum(0)


def main(paths) -> None:
    chosen = {p.stem: open_tile(p, size=(64, 64)).maps for p in paths} if paths else metals()
    print(f"| material | {' | '.join(SHADINGS)} |\n|{' --- |' * (1 + len(SHADINGS))}")
    for name, maps in chosen.items():
        found = " | ".join(f"{least_residual(maps, s):.2%}" for s in SHADINGS.values())
        print(f"| {name} | {found} |", flush=True)


if __name__ == "__main__":
    main([Path(word) for word in sys.argv[1:]])
