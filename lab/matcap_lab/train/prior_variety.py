"""Variety and realism of draws from a prior, against held-out photographs.

Draws are rendered in the middle of a photograph's plane under a flash; photographs, held out or
simulated with seeds that training never draws, are cropped to their middle. All are scaled to the
same mean radiance and compared by measures/variety.py. Interpolations between held-out photographs,
without fine-tuning, test the latent space: an implausible middle is farther from all photographs
than the ends are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from matcap.space.between import blend
from matcap.space.prior.store import Prior
from matcap_lab.experiment.results import Trial, Value, table
from matcap_lab.measures.style import StyleStatistics
from matcap_lab.measures.variety import describe_pictures, joined, style_distances, variety
from matcap_lab.train.evaluate import UNSEEN
from matcap_lab.train.pack import Entry, Pack, first_of_each
from matcap_lab.train.pictures import lit, middle, simulated_middle, write_grid

PAIRS = 10
_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
_MIDDLE = 2  # of the shares
_SHEET, _COLUMNS = 64, 8  # draws that are shown, and how many side by side
_ABOUT = (
    "Draws, and training photographs, beside photographs that training never saw, held out, "
    "simulated or all: precision and recall after Kynkaanniemi et al. (2019), third neighbours, by "
    "statistics of random filters that nothing is trained on; apart: mean style distance of two of "
    "them; spread: its share of that of two photographs. The rows of training photographs say what "
    "a space that shows nothing but what it was trained on would reach. Blends: style distance to "
    "the nearest of all photographs, the mean of both ends, of the middle, and their ratio."
)


@dataclass(frozen=True)
class VarietySettings:
    """Numbers of draws and of photographs."""

    draws: int = 256
    """Number of materials drawn, with seeds 0, 1, ..."""

    simulated: int = 64
    """Number of unseen simulated photographs, added to the held-out ones."""


def run_variety(
    prior: Prior,
    pack: Pack,
    settings: VarietySettings,
    out: Path,
    command: str,
    on_progress: Callable[[str], None] = lambda line: None,
) -> str:
    """Measure draws, write prior-variety.md and .jpg into a folder, and give the page."""
    real = [middle(entry) for entry in pack.reporting]
    simulated = [simulated_middle(UNSEEN + seed) for seed in range(settings.simulated)]
    on_progress(f"{len(real)} held-out photographs and {len(simulated)} simulated ones")
    drawn = []
    for seed in range(settings.draws):
        drawn.append(lit(prior.draw(seed)))
        if (seed + 1) % 16 == 0:
            on_progress(f"{seed + 1} of {settings.draws} draws")
    statistics = describe_pictures(real), describe_pictures(simulated)
    ceiling = describe_pictures([middle(entry) for entry in pack.training])
    references = {
        "all": joined(statistics),
        "photographs": statistics[0],
        "simulated": statistics[1],
    }
    made = {"draws": describe_pictures(drawn), "training photographs": ceiling}
    results = {
        (what, name): variety(ours, true)
        for what, true in references.items()
        for name, ours in made.items()
    }
    rows = [
        Trial("prior-variety", name, what, {
            "precision": one.precision, "recall": one.recall, "apart": one.mean_distance,
            "spread": one.spread,
        })
        for (what, name), one in results.items()
    ]  # fmt: skip
    blends = middles(prior, first_of_each(pack.reporting), joined([*statistics, ceiling]))
    rows += [row for row, _ in blends]
    pictures = (
        f"![{_SHEET} draws, in the order of the photographs they are nearest to]"
        "(prior-variety.jpg)\n\n![Blends, in five steps each](prior-blends.jpg)\n"
    )
    page = f"{table(rows, command, _ABOUT)}\n{pictures}"
    out.mkdir(parents=True, exist_ok=True)
    (out / "prior-variety.md").write_text(page, encoding="utf-8")
    order = results["all", "draws"].nearest[:_SHEET].argsort(stable=True).tolist()
    write_grid([drawn[index] for index in order], _COLUMNS, out / "prior-variety.jpg")
    write_grid([strip for _, strip in blends], 2, out / "prior-blends.jpg")
    return page


def middles(
    prior: Prior, entries: Sequence[Entry], photographs: StyleStatistics
) -> list[tuple[Trial, Tensor]]:
    """Blends of neighbours in a list of photographs of different materials, at most PAIRS.

    `photographs` are the statistics of those that pictures are compared with.

    Returns:
        For each the mean style distance of the ends to their nearest photographs, that of the
        middle, and their ratio; and its five steps side by side, (3, size, 5 size) sRGB.
    """
    places = [prior.place(entry.photo()) for entry in entries[: PAIRS + 1]]
    materials = [prior.draw(0, near=place, spread=0.0) for place in places]
    blends = []
    for index in range(len(materials) - 1):
        first, second = materials[index : index + 2]
        steps = [lit(blend(first, second, share)) for share in _SHARES]
        nearest = style_distances(describe_pictures(steps), photographs).min(dim=1).values
        ends, middle = float(nearest[[0, -1]].mean()), float(nearest[_MIDDLE])
        name = f"{entries[index].material} and {entries[index + 1].material}"
        ratio = middle / ends if ends else math.inf
        values: dict[str, Value] = {"ends": ends, "middle": middle, "ratio": ratio}
        blends.append((Trial("prior-variety", "blend", name, values), torch.cat(steps, dim=2)))
    return blends
