"""What materials drawn from a prior are worth beside photographs of materials it never saw.

Draws lie in the middle of a photograph's plane under a flash; of every photograph, held out or
simulated of a seed that training never draws, the middle is taken. All are brought to the same
mean radiance, and compared as measures/variety.py says.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from matcap.lab.measures.variety import Variety, describe_pictures, joined, variety
from matcap.lab.train.evaluate import UNSEEN
from matcap.lab.train.middles import Middle, middles
from matcap.lab.train.pack import Pack, first_of_each
from matcap.lab.train.pages import table
from matcap.lab.train.pictures import lit, middle, simulated_middle, write_grid
from matcap.space.prior.store import Prior

_SHEET, _COLUMNS = 64, 8  # draws that are shown, and how many side by side
_FARTHER = 1.3  # than the ends of a blend, at most, may its middle be from photographs


@dataclass(frozen=True)
class VarietySettings:
    """What is compared.

    Attributes:
        draws: how many materials are drawn, of seeds 0, 1, ...
        simulated: how many unseen simulated photographs stand beside the held-out ones.
    """

    draws: int = 256
    simulated: int = 64


def run_variety(
    prior: Prior,
    pack: Pack,
    settings: VarietySettings,
    out: Path,
    command: str,
    tell: Callable[[str], None] = lambda line: None,
) -> str:
    """Measure draws, write prior-variety.md and .jpg into a folder, and return the page."""
    real = [middle(entry) for entry in pack.reporting]
    seeds = range(UNSEEN, UNSEEN + settings.simulated)
    simulated = [simulated_middle(seed) for seed in seeds]
    tell(f"{len(real)} held-out photographs and {len(simulated)} simulated ones")
    known = [middle(entry) for entry in pack.training]
    drawn = []
    for seed in range(settings.draws):
        drawn.append(lit(prior.draw(seed)))
        if (seed + 1) % 16 == 0:
            tell(f"{seed + 1} of {settings.draws} draws")
    made, ceiling = describe_pictures(drawn), describe_pictures(known)
    told = describe_pictures(real), describe_pictures(simulated)
    sets = {"all": joined(told), "photographs": told[0], "simulated": told[1]}
    rows = [
        (f"{name}, {beside}", variety(ours, true))
        for beside, true in sets.items()
        for name, ours in (("draws", made), ("training photographs", ceiling))
    ]
    blends = middles(prior, first_of_each(pack.reporting), joined([*told, ceiling]))
    page = markdown(rows, blends, settings, len(real), command)
    out.mkdir(parents=True, exist_ok=True)
    (out / "prior-variety.md").write_text(page)
    order = rows[0][1].nearest[:_SHEET].argsort(stable=True).tolist()
    write_grid([drawn[index] for index in order], _COLUMNS, out / "prior-variety.jpg")
    write_grid([one.strip for one in blends], 2, out / "prior-blends.jpg")
    return page


def markdown(
    rows: Sequence[tuple[str, Variety]],
    blends: Sequence[Middle],
    settings: VarietySettings,
    real: int,
    command: str,
) -> str:
    """The page."""
    passed = sum(one.ratio <= _FARTHER for one in blends)
    lines = [
        "# How varied the space is",
        "",
        f"Made by `{command}`: {settings.draws} materials drawn from the prior, beside {real} "
        "held-out",
        f"photographs and {settings.simulated} simulated ones of seeds that training never draws.",
        "",
        *table(
            ["of, beside", "precision", "recall", "pairwise distance", "of theirs"],
            [
                [
                    name,
                    f"{found.precision:.2f}",
                    f"{found.recall:.2f}",
                    f"{found.apart:.3f}",
                    f"{found.spread:.2f}",
                ]
                for name, found in rows
            ],
        ),
        "",
        "Precision and recall after Kynkaanniemi et al. (2019), third neighbours, by statistics of",
        "random filters that nothing is trained on; all pictures are brought to",
        "the same mean radiance. Pairwise distance: mean style distance of two of them, and its",
        "share of that of two photographs. The rows of training photographs say what a space that",
        "shows nothing but what it was trained on would reach.",
        "",
        f"![{_SHEET} draws, in the order of the photographs they are nearest to]"
        "(prior-variety.jpg)",
        "",
        "## Blends",
        "",
        *table(
            ["between", "ends", "middle", "ratio"],
            [
                [
                    f"{one.first} and {one.second}",
                    f"{one.ends:.3f}",
                    f"{one.middle:.3f}",
                    f"{one.ratio:.2f}",
                ]
                for one in blends
            ],
        ),
        "",
        "Held-out photographs as they lie in the space, untuned, and the middle between two of",
        "them: style distance to the nearest of all photographs, held out, simulated or trained",
        f"on; for the ends the mean of both. {passed} of {len(blends)} middles are at most",
        f"{_FARTHER} times as far from any as their ends are.",
        "",
        "![Ten blends, in five steps each](prior-blends.jpg)",
        "",
    ]
    return "\n".join(lines)
