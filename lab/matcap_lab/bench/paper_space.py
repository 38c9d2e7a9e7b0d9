"""Interpolation and generation of `matcap-lab bench paper`: the paper shows pictures, no numbers.

Five steps between two captured materials, under the flash, by `matcap blend` and linear in maps;
and draws of `matcap sample` beside all map sets of a folder, under one flash at one exposure.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet, with_colour
from matcap.field.material import Material
from matcap.flash.geometry import FlashSetup
from matcap.space.between import blend
from matcap.space.prior.store import load_prior
from matcap_lab.experiment.results import Value
from matcap_lab.experiment.runner import Configuration, Experiment
from matcap_lab.measures.evaluator import Evaluator
from matcap_lab.measures.style import Style, difference
from matcap_lab.measures.variety import joined, mean_pairwise, style_distances
from matcap_lab.simulate.specimen import Specimen
from matcap_lab.train.pictures import SIZE, lit, lit_maps

LINEAR, SAMPLE = "linear in maps", "sample"
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
DRAWS = 32
_TEXEL = 2.0 / 1024.0  # of draws, plane units


@dataclass(frozen=True, eq=False)
class PaperSubject:
    """A material, its photograph and true samples (evaluator)."""

    path: Path
    evaluator: Evaluator


PaperCapture = Callable[[PaperSubject, int], tuple[Material, float]]  # by seed; processor seconds
PaperEnds = tuple[PaperSubject, PaperSubject]


def interpolation(
    subjects: Mapping[str, Callable[[], PaperSubject]],
    captures: Mapping[str, PaperCapture],
    settings: object,
) -> Experiment[PaperEnds, Mapping[str, Value]]:
    """Interpolations of each subject and the next one, of the last and the first."""

    def pair(first: str, second: str) -> PaperEnds:
        return subjects[first](), subjects[second]()

    def interpolated(name: str, pair: PaperEnds, seed: int) -> Mapping[str, Value]:
        first, second = (captures[name](subject, seed)[0] for subject in pair)
        evaluator, between = pair[0].evaluator, _linear if name == LINEAR else _blended
        steps = [between(first, second, share, evaluator) for share in SHARES]
        return _lengths(steps, evaluator)

    names = list(subjects)
    ends = zip(names, [*names[1:], *names[:1]], strict=True) if len(names) > 1 else ()
    return Experiment(
        "interpolation",
        {f"{first} to {second}": partial(pair, first, second) for first, second in ends},
        {name: Configuration(partial(interpolated, name)) for name in captures},
        settings=settings,
    )


Lit = tuple[MapSet, tuple[float, float, float]]  # maps and the intensity of their flash


def _blended(first: Material, second: Material, share: float, evaluator: Evaluator) -> Lit:
    material = blend(first, second, share)
    side = evaluator.side(material.texel_size)
    return material.maps(side, side), material.setup.intensity


def _linear(first: Material, second: Material, share: float, evaluator: Evaluator) -> Lit:
    (one, light), (other, light_there) = (
        _blended(first, second, end, evaluator) for end in (0.0, 1.0)
    )
    maps = torch.lerp(with_colour(one.stacked()), with_colour(other.stacked()), share)
    red, green, blue = torch.tensor(light).lerp(torch.tensor(light_there), share).tolist()
    return MapSet.from_stacked(maps, one.texel_size), (red, green, blue)


def _lengths(steps: Sequence[Lit], evaluator: Evaluator) -> dict[str, Value]:
    """Distances of the middle and of the longest step, over that of the ends."""
    pictures = [evaluator.relit(maps, light, evaluator.own_scene) for maps, light in steps]
    values: dict[str, Value] = {}
    for name, style in evaluator.styles.items():
        each = [style(picture) for picture in pictures]
        begin, _, middle, _, end = each
        whole = float(difference(begin, end))
        to_ends = max(float(difference(middle, one)) for one in (begin, end))
        longest = max(float(difference(a, b)) for a, b in zip(each, each[1:], strict=False))
        values[f"middle, {name}"] = to_ends / whole
        values[f"longest step, {name}"] = longest / whole
    return values


def generation(
    sets: Sequence[Specimen], styles: Mapping[str, Style], settings: object
) -> Experiment[list[Tensor], list[Tensor]]:
    """Draws of the prior beside map sets."""

    def real() -> list[Tensor]:
        return [lit_maps(one.realise(SIZE, SIZE, _TEXEL), FlashSetup()).float() for one in sets]

    def drawn(_: list[Tensor], seed: int) -> list[Tensor]:
        prior = load_prior()
        return [lit(prior.draw(seed * DRAWS + number)) for number in range(DRAWS)]

    def compared(real: list[Tensor], made: list[Tensor]) -> Mapping[str, Value]:
        values: dict[str, Value] = {}
        for name, style in styles.items():
            true, ours = (joined([style(one[None]) for one in each]) for each in (real, made))
            within = style_distances(true, true)
            closest = within.clone().fill_diagonal_(float("inf")).min(1).values.mean()
            nearest = style_distances(ours, true).min(1).values.mean()
            values[f"nearest, {name}"] = float(nearest / closest)
            between = mean_pairwise(style_distances(ours, ours))
            values[f"spread, {name}"] = between / mean_pairwise(within)
        return values

    subject = {f"{len(sets)} map sets": real}
    return Experiment(
        "generation", subject, {SAMPLE: Configuration(drawn)}, (compared,), settings=settings
    )
