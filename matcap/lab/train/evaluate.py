"""What a prior is worth: measured on photographs and materials it never saw.

Held-out photographs are captured with and without the prior, and compared as measure.py says,
beside the photograph as albedo. Writes a Markdown table and a picture. Every result is kept as soon
as it is there, and not made again by the next run into the same folder.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

from torch import Tensor, zeros

from matcap.lab.bench.methods import photo_as_albedo
from matcap.lab.train.align import evaluate_alignment, make
from matcap.lab.train.kept import key_of, once, photograph_key, prior_key
from matcap.lab.train.measure import (
    DETAIL,
    SIZE,
    Made,
    Photographed,
    Result,
    capture,
    judge,
    photographed,
)
from matcap.lab.train.pack import Entry, Pack, first_of_each
from matcap.lab.train.pages import COLUMNS, median, names, table, write_sheet
from matcap.space.decoder import CODE_SIZE, Decoder, DecoderConfig
from matcap.space.prior.store import Prior
from matcap.space.tuning.finetune import RATE_FROM_NOTHING, RATE_FROM_PRIOR
from matcap.space.tuning.start import log_contrast, untrained

UNSEEN = 1_000_000  # seeds from here on show simulated materials that training never draws
ALBEDO = "photograph as albedo"  # which is not ours to publish: not on the sheet


@dataclass(frozen=True)
class EvaluateSettings:
    """What is measured.

    Attributes:
        steps: of fine-tuning from the prior.
        longer: of fine-tuning from nothing.
        materials: how many held-out ones.
        tilted: unseen simulated photographs for the tilt.
        realisations: of each material, that are compared with each other.
    """

    steps: int = 100
    longer: int = 1000
    materials: int = 12
    tilted: int = 100
    realisations: int = 3


@dataclass(frozen=True)
class EvaluatedMethod:
    """One way from a photograph to pictures of its material.

    Attributes:
        name: a row of the table.
        run: the way.
        follows: everything its result follows from, beside its name and the photograph.
    """

    name: str
    run: Callable[[Photographed], Made]
    follows: tuple[object, ...] = ()


def run_evaluation(
    prior: Prior,
    pack: Pack,
    settings: EvaluateSettings,
    out: Path,
    command: str,
    tell: Callable[[str], None] = lambda line: None,
) -> str:
    """Measure, write prior-evaluation.md and .jpg into a folder, and return the table.

    Results are kept in its folder prior-evaluation; see kept.py.
    """
    entries = first_of_each(pack.reporting)[: settings.materials]
    results = measure_all(ways_of(prior, settings), entries, out / "prior-evaluation", tell)
    errors = evaluate_alignment(
        prior.alignment, make(range(UNSEEN, UNSEEN + settings.tilted), 512)
    ).abs()
    tell(f"tilt: {float(errors.mean()):.2f} degrees")
    page = markdown(results, errors, prior, command)
    (out / "prior-evaluation.md").write_text(page)
    shown = [result for result in results if result.method != ALBEDO]
    write_sheet(shown, out / "prior-evaluation.jpg")
    return page


def measure_all(
    ways: Sequence[EvaluatedMethod],
    entries: Sequence[Entry],
    folder: Path,
    tell: Callable[[str], None] = lambda line: None,
) -> list[Result]:
    """Every way on every photograph; those kept in the folder are not gone again."""
    results = []
    for entry in entries:
        # Decoded when the first way needs it: perhaps all of them are kept.
        shown = cache(partial(photographed, entry))
        for way in ways:
            key = key_of(way.name, photograph_key(entry), *way.follows)
            result = once(folder, key, partial(_measure, way, shown))
            tell(
                f"{result.material}  {way.name}: style {result.style:.3f}, xyz {result.xyz:.3f}, "
                f"diversity {result.diversity:.3f}, {result.seconds:.1f} s"
            )
            results.append(result)
    return results


def _measure(way: EvaluatedMethod, shown: Callable[[], Photographed]) -> Result:
    return judge(way.name, way.run(shown()), shown())


def ways_of(prior: Prior, settings: EvaluateSettings) -> list[EvaluatedMethod]:
    """From the prior, from nothing, and the photograph as albedo."""
    count, known = settings.realisations, prior_key(prior)

    def tuned(
        begin: Begin, steps: int, rate: float = RATE_FROM_NOTHING
    ) -> Callable[[Photographed], Made]:
        return lambda shown: capture(shown, partial(begin, shown), steps, count, rate)

    start = partial(from_prior, prior)
    few, many = settings.steps, settings.longer
    return [
        EvaluatedMethod("prior, not tuned", tuned(start, 0), (count, known)),
        EvaluatedMethod(
            f"prior, {few} steps",
            tuned(start, few, RATE_FROM_PRIOR),
            (count, known, RATE_FROM_PRIOR),
        ),
        EvaluatedMethod(f"nothing, {few} steps", tuned(from_nothing, few), (count,)),
        EvaluatedMethod(f"nothing, {many} steps", tuned(from_nothing, many), (count,)),
        EvaluatedMethod(ALBEDO, albedo),
    ]


def albedo(shown: Photographed) -> Made:
    """The photograph as diffuse albedo (bench/baselines.py): its corner, laid in its middle.

    In its own place it would be compared with itself, lit a second time, and look right where no
    other piece of it would. There is one picture of it, so its diversity is 0.
    """
    began = time.perf_counter()
    fixed = photo_as_albedo(shown.photo, shown.scene.setup, DETAIL)
    seconds = time.perf_counter() - began
    corner = fixed.whole.crop(0, 0, SIZE, SIZE)
    return Made(shown.lit(corner, fixed.setup)[None], seconds)


Begin = Callable[[Photographed], tuple[Decoder, Tensor]]


def from_prior(prior: Prior, shown: Photographed) -> tuple[Decoder, Tensor]:
    """Decoder and code as the prior has them for a photograph."""
    return prior.start(shown.photo.pixels, shown.entry.coarse, shown.plane)


def from_nothing(shown: Photographed, kind: type[Decoder] = Decoder) -> tuple[Decoder, Tensor]:
    """A random decoder around the coarse fit, and a code of zeros."""
    contrast = log_contrast(shown.plane.linear, shown.plane.valid)
    return untrained(DecoderConfig(), shown.entry.coarse, contrast, 0, kind), zeros(CODE_SIZE)


def markdown(results: Sequence[Result], tilt_errors: Tensor, prior: Prior, command: str) -> str:
    """The page."""
    methods, materials = names(results, lambda r: r.method), names(results, lambda r: r.material)
    style = {(r.material, r.method): r.style for r in results}
    summary = [
        [
            method,
            f"{median(results, method, lambda r: r.style):.3f}",
            f"{median(results, method, lambda r: r.xyz):.3f}",
            f"{median(results, method, lambda r: r.diversity):.3f}",
            f"{median(results, method, lambda r: r.seconds):.1f}",
        ]
        for method in methods
    ]
    each = [[m, *(f"{style[m, method]:.3f}" for method in methods)] for m in materials]
    mean, worst = float(tilt_errors.mean()), float(tilt_errors.quantile(0.95))
    lines = [
        "# What the prior is worth",
        "",
        f"Made by `{command}`: {len(materials)} held-out photographs, re-rendered under their own",
        "flash.",
        "",
        *table(["method", "style", "XYZ", "diversity", "seconds"], summary),
        "",
        COLUMNS,
        "",
        f"*{ALBEDO.capitalize()}* is the photograph's corner laid in its middle and lit once more;",
        "in its own place it would be compared with itself. How methods look under other lights is",
        "measured where the truth is known, by `matcap bench quality` (docs/notes/quality.md).",
        "",
        "Style error of each photograph:",
        "",
        *table(["material", *methods], each),
        "",
        f"Tilt of {len(tilt_errors)} simulated photographs of unseen materials, up to 15 degrees",
        f"either way: mean absolute error {mean:.2f} degrees, 95th percentile {worst:.2f}.",
        "",
        f"Codes of the training photographs: {prior.about.get('dead_dimensions', math.nan)} of",
        f"{CODE_SIZE} dimensions dead.",
        "",
        "![Columns: the materials in this order. Rows: the methods that do not show the photograph",
        "itself, in the order of the table.](prior-evaluation.jpg)",
        "",
    ]
    return "\n".join(lines)
