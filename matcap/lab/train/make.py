"""`matcap prior make`: from a folder of photographs to a prior, by one recipe and one command.

Corpus, training, finishing, alignment branch, card; what an earlier run has done is not done again,
and a training that was killed goes on from its checkpoint. A recipe is the TOML of a training
(settings.py) with two tables more: `[corpus]` (`simulated` photographs and their `seed`) and
`[alignment]` (`materials` and `steps`, and the `fused` materials of its fusion; without it no
branch is trained).
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from matcap.errors import UsageError
from matcap.files.output import Output
from matcap.lab.train.align import report_alignment
from matcap.lab.train.corpus import build
from matcap.lab.train.finish import finish
from matcap.lab.train.fusion import MATERIALS, train_branch
from matcap.lab.train.pack import Pack
from matcap.lab.train.settings import configured, read_toml
from matcap.lab.train.train import train
from matcap.lab.train.trainer import CHECKPOINT, CURVES
from matcap.space.alignment import load_alignment, save_alignment
from matcap.space.prior.store import Prior

_TABLES: Mapping[str, Mapping[str, int]] = {
    "corpus": {"simulated": 0, "seed": 0},
    "alignment": {"materials": 0, "steps": 2000, "fused": MATERIALS},
}


def make_prior(
    folder: Path | None,
    recipe: Path,
    out: Path,
    on_progress: Callable[[str], None] = lambda line: None,
) -> Prior:
    """Make a prior, its card (.md) and, if the recipe has one, an alignment branch.

    Args:
        folder: of photographs named MATERIAL_anything.jpg; None for simulated ones alone.
        recipe: TOML.
        out: the prior's file; the corpus and the training are kept in the folder of its name.
        on_progress: called with a line now and then.

    Raises:
        UsageError: a recipe that cannot be read, or has a name that is not known.
        MatcapError: no photograph can be used; a kept file is broken.
    """
    stated, tables = _recipe(recipe)
    config = configured(stated, str(recipe))
    place = out.with_suffix("")
    kept = place / "corpus.pack"
    if not kept.exists():
        place.mkdir(parents=True, exist_ok=True)
        corpus = tables["corpus"]
        build(folder, corpus["simulated"], corpus["seed"], on_progress)[0].save(kept)
    pack = Pack.load(kept)
    begun = (place / CHECKPOINT).exists()
    trained = train(pack, config, place, resume=begun, on_progress=on_progress).average
    prior = finish(trained.encoder, trained.decoder, pack.training, {"steps": config.steps})
    prior.save(out)
    branch = place / "alignment.safetensors"
    materials, steps, fused = tables["alignment"].values()
    if materials and not branch.exists():
        made = train_branch(materials, steps, fused=fused, on_progress=on_progress)
        save_alignment(branch, made)
    count = min(24, materials)
    card = _card(prior, pack, recipe, place, branch if count else None, count)
    with Output.file(out.with_suffix(".md")) as file:
        file.write_text(card, encoding="utf-8")
    return prior


def _recipe(path: Path) -> tuple[dict[str, Any], dict[str, dict[str, int]]]:
    """What a recipe states of the training, and its tables with defaults filled in."""
    stated, tables = read_toml(path), {}
    for name, defaults in _TABLES.items():
        given = stated.pop(name, {})
        wrong = [
            key
            for key, value in given.items()
            if key not in defaults or type(value) is not int or value < 0
        ]
        if wrong:
            raise UsageError.at(
                f"{path}, {name}",
                f"'{wrong[0]}' is not a number of this table",
                f"use {', '.join(defaults)}",
            )
        tables[name] = {**defaults, **given}
    return stated, tables


def _card(
    prior: Prior, pack: Pack, recipe: Path, place: Path, branch: Path | None, count: int
) -> str:
    """Markdown card of a prior: data, recipe, losses and measured quality."""
    simulated = sum(entry.simulated for entry in pack.training)
    lines = [
        "# A prior",
        "",
        f"Made by `matcap prior make` of {len(pack.training) - simulated} photographs and "
        f"{simulated} simulated ones; {len(pack.entries) - len(pack.training)} held out.",
        f"{prior.about['dead_dimensions']} of the code's dimensions are dead.",
        "",
    ]
    curves = place / CURVES
    if curves.exists():
        with curves.open(encoding="utf-8", newline="") as file:
            *_, last = csv.DictReader(file)
        columns = ", ".join(f"{name} {value}" for name, value in last.items())
        lines += [f"At the end of training: {columns}.", ""]
    if branch is not None:
        lines += ["Alignment branch, on kinds never trained on, degrees:", ""]
        lines += [report_alignment(load_alignment(branch), count), ""]
    lines += ["Recipe:", "", "```toml", recipe.read_text(encoding="utf-8").rstrip(), "```", ""]
    return "\n".join(lines)
