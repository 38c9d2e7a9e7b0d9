"""Blind pairwise comparison of captures: agreement of human judgements with the measures.

Sheets of `matcap-lab bench fronts`, the truth in the middle, one capture on either side, several
pairs to a page. A CSV identifies them; its column `nearer` (left, right or neither) is to be filled
in before reading the others.
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap_lab.experiment.results import markdown, read

_ON_A_PAGE = 5
_MARGIN = 8  # pixels
_MEASURES = ("field", "fine", "flash", "patches", "filters")
_SEPARATION = 1.1  # ratio of errors; smaller ones are within the scatter of seeds


def write_pairs(fronts: Path, out: Path, count: int, seed: int) -> Path:
    """Draw pairs of the sheets in a folder of fronts; pages and pairs.csv go to `out`.

    `count` pairs are spread over the materials; `seed` is of their choice and of their sides.

    Raises:
        MatcapError: there are no two sheets of one material.
    """
    drawn = _drawn(fronts / "sheets", count, seed)
    if not drawn:
        raise MatcapError.at(fronts, "there are no captures to be compared", "measure first")
    out.mkdir(parents=True, exist_ok=True)
    for first in range(0, len(drawn), _ON_A_PAGE):
        rows = [
            _row(fronts / "sheets" / material, (left, right), number)
            for number, (material, left, right) in enumerate(
                drawn[first : first + _ON_A_PAGE], start=first + 1
            )
        ]
        cv2.imwrite(str(out / f"page-{first // _ON_A_PAGE + 1}.png"), np.concatenate(rows))
    table = out / "pairs.csv"
    with table.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("pair", "material", "left", "right", "nearer"))
        writer.writerows((number, *each, "") for number, each in enumerate(drawn, start=1))
    return table


def agreement(table: Path) -> list[str]:
    """Share of judged pairs in which each measure agrees, as Markdown; empty without judgements.

    Over all pairs judged left or right, over those whose measures differ by 10 % or more, and over
    those of which one is a decoder's.
    Rows of configurations that `matcap` has no more are in compared.csv next to the table.
    """
    path = table.with_name("pairs.csv")
    if not path.exists():
        return []
    earlier, rows = table.with_name("compared.csv"), read(table)
    measured = [*rows, *(read(earlier) if earlier.exists() else ())]
    experiments = {row.experiment for row in rows}
    known = {
        (row.subject, row.configuration): row
        for row in measured
        if row.seed == 0 and row.experiment in experiments
    }
    with path.open(encoding="utf-8") as file:
        judged = [row for row in csv.DictReader(file) if row["nearer"] in ("left", "right")]
    compared = [
        (known[row["material"], row["left"]], known[row["material"], row["right"]], row["nearer"])
        for row in judged
        if all((row["material"], row[side]) in known for side in ("left", "right"))
    ]
    if not compared:
        return []
    decoders = [
        any(row.configuration.startswith("decoder") for row in (a, b)) for a, b, _ in compared
    ]
    lines = []
    for name in _MEASURES:
        both = [(a.number(name), b.number(name), nearer) for a, b, nearer in compared]
        separate = [(a, b, nearer) for a, b, nearer in both if max(a, b) >= _SEPARATION * min(a, b)]
        drawn = [pair for pair, decoder in zip(both, decoders, strict=True) if decoder]
        lines.append([name, _agreed(both), _agreed(separate), _agreed(drawn)])
    head = ["measure", "agrees", f"{_SEPARATION - 1.0:.0%} apart, agrees", "one a decoder, agrees"]
    about = (
        f"Blind comparison of pairs ({path.name}): in {len(compared)} one was nearer to the truth."
    )
    return ["### Agreement with people", "", about, "", *markdown(head, lines), ""]


def _agreed(pairs: Sequence[tuple[float, float, str]]) -> str:
    """Number of agreements, number of pairs, and their ratio."""
    count = sum((left < right) == (nearer == "left") for left, right, nearer in pairs)
    return f"{count} of {len(pairs)}, {count / max(len(pairs), 1):.0%}"


def _drawn(sheets: Path, count: int, seed: int) -> list[tuple[str, str, str]]:
    """(material, left, right) of each pair; materials alternate."""
    rng = np.random.default_rng(seed)
    by_material: list[list[tuple[str, str, str]]] = []
    for folder in sorted(path for path in sheets.iterdir() if path.is_dir()):
        # Seeds of one configuration hardly differ.
        names = [p.stem for p in sorted(folder.glob("*.png")) if ", seed " not in p.stem]
        pairs = list(itertools.combinations([name for name in names if name != "truth"], 2))
        of_one = [pairs[int(place)] for place in rng.permutation(len(pairs))]
        turned = [pair[::-1] if rng.random() < 0.5 else pair for pair in of_one]
        by_material.append([(folder.name, *pair) for pair in turned])
    turns = itertools.chain.from_iterable(itertools.zip_longest(*by_material))
    return list(itertools.islice((pair for pair in turns if pair), count))


def _row(folder: Path, pair: Sequence[str], number: int) -> NDArray[np.uint8]:
    """Picture of a numbered pair: left, truth, right, each under a sheet's two lights."""
    shown = []
    for name in (pair[0], "truth", pair[1]):
        picture = cv2.imread(str(folder / f"{name}.png"), cv2.IMREAD_COLOR)
        assert picture is not None
        half = len(picture) // 2
        shown.append(np.concatenate([picture[:half], picture[half:]], axis=1))
    pad = ((_MARGIN, _MARGIN), (_MARGIN, _MARGIN), (0, 0))
    row = np.concatenate([np.pad(each, pad, constant_values=255) for each in shown], axis=1)
    row = np.ascontiguousarray(row)
    cv2.putText(row, f"{number}", (14, 34), cv2.FONT_HERSHEY_SIMPLEX, 0.9, (0, 0, 255), 2)
    return row
