"""What each part of the method is worth: the same captures without it (paper, section 5.4).

FULL starts from the prior and fine-tunes. SINGLE starts from nothing. NONTUNED does not fine-tune.
DECODERONLY starts from nothing, too, and has no way down (decoder_only.py). FOURIER leaves the
power spectrum out of fine-tuning. LIGHT leaves the tilt out: the photograph counts as taken from
straight above.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from matcap.lab.train.decoder_only import DecoderOnly
from matcap.lab.train.evaluate import Begin, EvaluatedMethod, from_nothing, from_prior, measure_all
from matcap.lab.train.kept import prior_key
from matcap.lab.train.measure import Made, Photographed, Result, capture, photographed
from matcap.lab.train.pack import Pack, first_of_each
from matcap.lab.train.pages import COLUMNS, median, names, table, write_sheet
from matcap.space.prior.store import Prior
from matcap.space.tuning.finetune import RATE_FROM_NOTHING, RATE_FROM_PRIOR
from matcap.statistics.compare import Weights

FULL, SINGLE, DECODER_ONLY = "FULL", "SINGLE", "DECODERONLY"
_REALISATIONS = 3


def run_ablation(
    prior: Prior,
    pack: Pack,
    steps: int,
    materials: int,
    out: Path,
    command: str,
    tell: Callable[[str], None] = lambda line: None,
) -> str:
    """Measure, write prior-ablation.md and .jpg into a folder, and return the table.

    Results are kept in its folder prior-ablation; see kept.py.
    """
    entries = first_of_each(pack.reporting)[:materials]
    results = measure_all(variants(prior, steps), entries, out / "prior-ablation", tell)
    page = _markdown(results, steps, command)
    (out / "prior-ablation.md").write_text(page)
    write_sheet(results, out / "prior-ablation.jpg")
    return page


def variants(prior: Prior, steps: int) -> list[EvaluatedMethod]:
    """FULL and what is left without one part each."""
    start, known = partial(from_prior, prior), prior_key(prior)

    def way(
        name: str, begin: Begin, view: Callable[[Photographed], Photographed] | None = None
    ) -> EvaluatedMethod:
        def run(shown: Photographed) -> Made:
            # Every variant is compared with the photograph as it is, however it sees it itself.
            tuned = view(shown) if view else shown
            return capture(tuned, partial(begin, tuned), taken, _REALISATIONS, rate)

        taken = 0 if name == "NONTUNED" else steps
        rate = RATE_FROM_PRIOR if begin is start else RATE_FROM_NOTHING
        trained = (known, rate) if begin is start else ()
        return EvaluatedMethod(name, run, (taken, _REALISATIONS, *trained))

    return [
        way(FULL, start),
        way(SINGLE, from_nothing),
        way("NONTUNED", start),
        way(DECODER_ONLY, partial(from_nothing, kind=DecoderOnly)),
        way("FOURIER", start, _without_spectrum),
        way("LIGHT", start, _without_tilt),
    ]


def _without_spectrum(shown: Photographed) -> Photographed:
    return replace(shown, scene=replace(shown.scene, weights=Weights(spectrum=0.0)))


def _without_tilt(shown: Photographed) -> Photographed:
    coarse = shown.entry.coarse
    straight = replace(coarse, setup=replace(coarse.setup, tilt=(0.0, 0.0)))
    return photographed(replace(shown.entry, coarse=straight))


def _markdown(results: list[Result], steps: int, command: str) -> str:
    def style(variant: str) -> float:
        return median(results, variant, lambda r: r.style)

    full = style(FULL)
    rows = [
        [
            variant,
            f"{style(variant):.3f}",
            f"{100.0 * style(variant) / full:.0f} %",
            f"{median(results, variant, lambda r: r.xyz):.3f}",
            f"{median(results, variant, lambda r: r.diversity):.3f}",
        ]
        for variant in names(results, lambda r: r.method)
    ]
    count = len(names(results, lambda r: r.material))
    beside_single = 100.0 * style(DECODER_ONLY) / style(SINGLE)
    lines = [
        "# What each part is worth",
        "",
        f"Made by `{command}`: {count} held-out photographs, {steps} steps of fine-tuning.",
        "",
        *table(["variant", "style", "of FULL", "XYZ", "diversity"], rows),
        "",
        COLUMNS,
        "",
        f"{DECODER_ONLY} has no prior of its own and starts from nothing, so it is to be compared",
        f"with {SINGLE}: it has {beside_single:.0f} % of its style error.",
        "",
        "![Columns: the materials. Rows: the variants in this order.](prior-ablation.jpg)",
        "",
    ]
    return "\n".join(lines)
