"""All domains of relighting and exporting, swept one after the other, and their table."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from stable.edges import exporting, relief, scenes, shading
from stable.edges.swept import LONGEST, Domain, Swept, sweep


@dataclass(frozen=True)
class Edge:
    """One domain.

    Attributes:
        domain: draws and measures.
        share: of all draws.
        measure: what its errors are relative to.
    """

    domain: Domain
    share: float
    measure: str


EDGES: Mapping[str, Edge] = MappingProxyType(
    {
        "lobes, roughness from 0.03": Edge(shading.lobes, 0.25, "the value, or 1e-6/sr"),
        "lobes, roughness below 0.03": Edge(shading.smooth_lobes, 0.15, "the value, or 1e-6/sr"),
        "albedo tables, n.v from 0.01": Edge(shading.tables, 0.006, "all light"),
        "albedo tables, n.v below 0.01": Edge(shading.grazing_tables, 0.004, "all light"),
        "compensation, white furnace": Edge(shading.furnace, 0.1, "all light"),
        "point and directional lights": Edge(
            shading.point_lights, 0.1, "the value, or 1e-4 of the brightest"
        ),
        "area lights, diffuse": Edge(
            shading.area_lights, 0.1, "the value, or 1e-4 of the brightest"
        ),
        "environments": Edge(shading.environments, 0.04, "the brightest pixel of a colour"),
        "filtering, squares of 2^k texels": Edge(relief.filtering, 0.07, "the value, or 1"),
        "filtering, footprints 1e-30 to 1e30": Edge(relief.footprints, 0.06, "1"),
        "parallax: the ray ends on the surface": Edge(relief.parallaxes, 0.05, "the relief"),
        "parallax: ridges passed through": Edge(relief.crossings, 0.02, "half a texel of path"),
        "shadows": Edge(relief.shadowed, 0.02, "a quarter of a cell's twist"),
        "meshes": Edge(scenes.meshes, 0.03, "the value, or the mesh's size"),
        "whole scenes of any numbers": Edge(scenes.scenes, 0.1, ""),
        "metallic workflow": Edge(exporting.metallic, 0.05, "1"),
        "textures written and read": Edge(exporting.textures, 0.05, "half a step of the file"),
        "targets and presets": Edge(exporting.targets, 0.01, ""),
    }
)


def run_edges(
    draws: int, seed: int, tell: Callable[[str], None] = lambda _line: None
) -> dict[str, Swept]:
    """Every domain by its name; `tell` hears of each.

    Args:
        draws: values in all, about; each domain is called once at least.
        seed: of all.
    """
    found = {}
    for name, edge in EDGES.items():
        found[name] = sweep(edge.domain, max(1, round(edge.share * draws)), seed)
        tell(f"{name:40} {_figures(found[name], ' ')}")
    return found


def failures(found: Mapping[str, Swept]) -> int:
    """Values that were not finite, and domains with a call that took too long."""
    return sum(one.broken + (one.slowest > LONGEST) for one in found.values())


def edges_markdown(found: Mapping[str, Swept]) -> str:
    """The table as a part of documentation."""
    lines = [
        "| domain | draws | not finite | refused | worst error | longest call, s | relative to | "
        "where |",
        "|---|---:|---:|---:|---:|---:|---|---|",
    ]
    lines += [
        f"| {name} | {_figures(one, ' | ')} | {EDGES[name].measure} | {one.where} |"
        for name, one in found.items()
    ]
    lines.append(f"| all | {_figures(_all(list(found.values())), ' | ', worst=False)} | | |")
    return "\n".join(lines) + "\n"


def _all(found: Sequence[Swept]) -> Swept:
    return sum(found, Swept())


def _figures(one: Swept, between: str, *, worst: bool = True) -> str:
    error = f"{one.worst:.1e}" if worst else ""
    return between.join(
        (str(one.draws), str(one.broken), str(one.refused), error, f"{one.slowest:.1f}")
    )
