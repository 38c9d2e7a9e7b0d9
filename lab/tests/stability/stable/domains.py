"""All domains that are swept, in groups, as an experiment of the laboratory's."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from types import MappingProxyType

from matcap_lab.experiment.results import Trial, Value
from matcap_lab.experiment.runner import Configuration, Experiment
from stable import captures
from stable.edges import exporting, relief, scenes, shading
from stable.edges.swept import Domain, Swept, sweep
from stable.photographs import HARD_PHOTOGRAPHS
from stable.reflectance import CASES, reflected, rendered
from stable.wholes import BRACKETED, HARD_SETS, PARTS


@dataclass(frozen=True)
class Entry:
    """One domain."""

    domain: Domain
    """Draws and measures."""
    share: float
    """Share of its group's draws; each domain is called once at least."""
    measure: str = ""
    """What its errors are relative to."""


_RELIGHTING: Mapping[str, Entry] = MappingProxyType(
    {
        "lobes, roughness from 0.03": Entry(
            partial(shading.lobes, smooth=False), 0.25, "the value, or 1e-6/sr"
        ),
        "lobes, roughness below 0.03": Entry(
            partial(shading.lobes, smooth=True), 0.15, "the value, or 1e-6/sr"
        ),
        "albedo tables, n.v from 0.01": Entry(
            partial(shading.tables, grazing=False), 0.006, "all light"
        ),
        "albedo tables, n.v below 0.01": Entry(
            partial(shading.tables, grazing=True), 0.004, "all light"
        ),
        "compensation, white furnace": Entry(shading.furnace, 0.1, "all light"),
        "point and directional lights": Entry(
            shading.point_lights, 0.1, "the value, or 1e-4 of the brightest"
        ),
        "area lights, diffuse": Entry(
            shading.area_lights, 0.1, "the value, or 1e-4 of the brightest"
        ),
        "environments": Entry(shading.environments, 0.04, "the brightest pixel of a colour"),
        "filtering, squares of 2^k texels": Entry(relief.filtering, 0.07, "the value, or 1"),
        "filtering, footprints 1e-30 to 1e30": Entry(relief.footprints, 0.06, "1"),
        "parallax: the ray ends on the surface": Entry(relief.parallaxes, 0.05, "the relief"),
        "parallax: ridges passed through": Entry(relief.crossings, 0.02, "half a texel of path"),
        "shadows": Entry(relief.shadowed, 0.02, "a quarter of a cell's twist"),
        "whole scenes of any numbers": Entry(scenes.scenes, 0.1, ""),
        "metallic workflow": Entry(exporting.metallic, 0.05, "1"),
        "textures written and read": Entry(exporting.textures, 0.05, "half a step of the file"),
        "targets and presets": Entry(exporting.targets, 0.01, ""),
    }
)


def _even(domains: Mapping[str, Domain], measure: str = "") -> Mapping[str, Entry]:
    return {name: Entry(one, 1.0 / len(domains), measure) for name, one in domains.items()}


_WHOLES = {f"set: {name}": captures.sets(name) for name in HARD_SETS}
_WHOLES |= {f"part: {name}": captures.parts(name) for name in PARTS}
_WHOLES |= {f"bracket: {name}": captures.brackets(name) for name in BRACKETED}
DOMAINS: Mapping[str, Mapping[str, Entry]] = {
    "reflectance": _even(
        {name: reflected(case) for name, case in CASES.items()}
        | {"rendering, light 1e-3 to 1e9 away": rendered},
        "the value, or 1e-6/sr",
    ),
    "photographs": _even({name: captures.photographs(name) for name in HARD_PHOTOGRAPHS}),
    "sets": _even(_WHOLES),
    "relighting": _RELIGHTING,
}
# Draws of each group: of a night, and of a few minutes.
USUAL = {"reflectance": 10_000_000, "photographs": 500, "sets": 300, "relighting": 10_000_000}
QUICK = {"reflectance": 100_000, "photographs": 37, "sets": 36, "relighting": 200_000}
# Processor seconds that one call may take: the exemplar of 1152 texels, of six photographs.
LONGEST = {"reflectance": 10.0, "photographs": 60.0, "sets": 120.0, "relighting": 10.0}


def stability_experiment(group: str, draws: int, seed: int) -> Experiment[Entry, Swept]:
    """So many draws of a group, over all its domains."""

    order = list(DOMAINS[group].values())

    def swept(entry: Entry, _seed: int) -> Swept:
        # Each domain draws its own, or the first photograph of all kinds would be of one size.
        return sweep(entry.domain, max(1, round(entry.share * draws)), [seed, order.index(entry)])

    def prepared(entry: Entry) -> Callable[[], Entry]:
        return lambda: entry

    return Experiment(
        f"stability-{group}",
        {name: prepared(entry) for name, entry in DOMAINS[group].items()},
        {"seed " + str(seed): Configuration(swept)},
        (columns,),
        settings=draws,
    )


def columns(entry: Entry, found: Swept) -> Mapping[str, Value]:
    """What was found, and what it is relative to."""
    return {**asdict(found), "relative to": entry.measure}


def failures(group: str, rows: list[Trial]) -> int:
    """Values that were not finite, and domains with a call that took too long."""
    longest = LONGEST[group]
    return sum(int(row.number("broken")) + (row.number("slowest") > longest) for row in rows)
