"""What each part of the method is worth: the same captures without it (paper, section 5).

FULL starts from the prior and fine-tunes. SINGLE starts from nothing. NONTUNED does not fine-tune.
FOURIER leaves the power spectrum out of fine-tuning. LIGHT leaves the tilt out: the photograph
counts as taken from straight above. DECODERONLY, a decoder without its way down, would need a
training of its own and is not here.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from torch import Tensor, zeros

from matcap.capture.start import log_contrast, untrained
from matcap.export.picture import write_picture
from matcap.model.decoder import CODE_SIZE, Decoder, DecoderConfig
from matcap.prior.evaluate import (
    PHOTOGRAPH,
    Photographed,
    Result,
    capture_once,
    photographed,
    sheet,
)
from matcap.prior.journal import first_of_each
from matcap.prior.pack import Entry, Pack
from matcap.prior.store import Prior
from matcap.statistics.compare import Weights

VARIANTS = ("FULL", "SINGLE", "NONTUNED", "FOURIER", "LIGHT")


def run_ablation(
    prior: Prior,
    pack: Pack,
    steps: int,
    materials: int,
    out: Path,
    command: str,
    tell: Callable[[str], None] = lambda line: None,
) -> str:
    """Measure, write prior-ablation.md and .png into a folder, and return the table."""
    results: list[Result] = []
    for entry in first_of_each(pack.reporting)[:materials]:
        shown = photographed(entry)
        results.append(Result(entry.material, PHOTOGRAPH, 0.0, 0.0, shown.truth))
        for variant in VARIANTS:
            results.append(_capture(prior, entry, shown, variant, steps))
            tell(f"{entry.material}  {variant}: {results[-1].style:.3f}")
    table = _markdown(results, steps, command)
    out.mkdir(parents=True, exist_ok=True)
    (out / "prior-ablation.md").write_text(table)
    write_picture(sheet(results), out / "prior-ablation.png")
    return table


def _capture(prior: Prior, entry: Entry, shown: Photographed, variant: str, steps: int) -> Result:
    if variant == "LIGHT":
        coarse = replace(entry.coarse, setup=replace(entry.coarse.setup, tilt=(0.0, 0.0)))
        entry = replace(entry, coarse=coarse)
        tuned = photographed(entry)
    else:
        tuned = shown
    if variant == "FOURIER":
        tuned = replace(tuned, scene=replace(tuned.scene, weights=Weights(spectrum=0.0)))

    def begin() -> tuple[Decoder, Tensor]:
        if variant == "SINGLE":
            contrast = log_contrast(tuned.linear, tuned.valid)
            return untrained(DecoderConfig(), entry.coarse, contrast, 0), zeros(CODE_SIZE)
        return prior.start(tuned.photo, entry.coarse, tuned.linear, tuned.valid)

    # Every variant is compared with the photograph as it is.
    return capture_once(tuned, shown, variant, begin, 0 if variant == "NONTUNED" else steps)


def _markdown(results: list[Result], steps: int, command: str) -> str:
    medians = {
        variant: statistics.median(r.style for r in results if r.method == variant)
        for variant in VARIANTS
    }
    count = len({r.material for r in results})
    lines = [
        "# What each part is worth",
        "",
        f"Made by `{command}`: {count} held-out photographs, {steps} steps of fine-tuning, style",
        "error under the photograph's own flash by random filters that no capture optimises.",
        "",
        "| variant | median error | of FULL |",
        "|---|---:|---:|",
    ]
    for variant, median in medians.items():
        lines.append(f"| {variant} | {median:.3f} | {100.0 * median / medians['FULL']:.0f} % |")
    lines += [
        "",
        "DECODERONLY is not measured: it needs a training of its own.",
        "",
        "![Rows: the variants in this order.](prior-ablation.png)",
        "",
    ]
    return "\n".join(lines)
