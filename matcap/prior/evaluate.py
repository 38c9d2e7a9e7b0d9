"""What a prior is worth: measured on photographs and materials it never saw.

Style is measured by random filters that no capture optimises (bench/style.py), between held-out
photographs and their captures re-rendered under the photograph's own flash. Writes a Markdown
table and a picture.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from matcap.bench.relit import srgb
from matcap.bench.style import RandomFilters, difference
from matcap.capture.finetune import Scene, TuneSettings, finetune
from matcap.capture.start import log_contrast, untrained
from matcap.capture.windows import cut_windows
from matcap.export.picture import write_picture
from matcap.flash.geometry import plane_points
from matcap.flash.rectify import rectify
from matcap.flash.render import render_flash
from matcap.model.decoder import CODE_SIZE, Decoder, DecoderConfig
from matcap.model.freeze import freeze
from matcap.model.material import Material
from matcap.photo.photo import Photo
from matcap.prior.align import evaluate_alignment, make
from matcap.prior.journal import first_of_each
from matcap.prior.look import FEATURES
from matcap.prior.pack import Entry, Pack
from matcap.prior.store import Prior
from matcap.statistics.encoding import fit_encoding
from matcap.statistics.filterbank import FilterBank

UNSEEN = 1_000_000  # seeds from here on show simulated materials that training never draws
PHOTOGRAPH = "photograph"  # the method of results that show the photograph itself
_DETAIL = 1024
_WINDOW = 160
_SIZE = 384  # texels a side of the pictures compared
_FLOAT = torch.float32


@dataclass(frozen=True)
class EvaluateSettings:
    """What is measured.

    Attributes:
        steps: of fine-tuning from the prior.
        longer: of fine-tuning from nothing.
        materials: how many held-out ones.
        tilted: unseen simulated photographs for the tilt.
    """

    steps: int = 100
    longer: int = 1000
    materials: int = 12
    tilted: int = 100


@dataclass(frozen=True)
class Result:
    """One way to a material on one photograph.

    Attributes:
        material: held-out one's name.
        method: a key of the table.
        style: error by random filters.
        seconds: that it took.
        picture: (3, _SIZE, _SIZE) sRGB, under the photograph's flash.
    """

    material: str
    method: str
    style: float
    seconds: float
    picture: Tensor


def run_evaluation(
    prior: Prior,
    pack: Pack,
    settings: EvaluateSettings,
    out: Path,
    command: str,
    tell: Callable[[str], None] = lambda line: None,
) -> str:
    """Measure, write prior-evaluation.md and .png into a folder, and return the table."""
    results: list[Result] = []
    for entry in first_of_each(pack.reporting)[: settings.materials]:
        for result in held_out_results(prior, entry, settings):
            tell(f"{result.material}  {result.method}: {result.style:.3f}, {result.seconds:.1f} s")
            results.append(result)
    errors = evaluate_alignment(
        prior.alignment, make(range(UNSEEN, UNSEEN + settings.tilted), 512)
    ).abs()
    tell(f"tilt: {float(errors.mean()):.2f} degrees")
    table = markdown(results, errors, prior, command)
    out.mkdir(parents=True, exist_ok=True)
    (out / "prior-evaluation.md").write_text(table)
    write_picture(sheet(results), out / "prior-evaluation.png")
    return table


@dataclass(frozen=True)
class Photographed:
    """A photograph ready to be captured.

    Attributes:
        entry: what the pack says.
        photo: decoded.
        linear, valid: rectified.
        scene: for fine-tuning.
        truth: (3, _SIZE, _SIZE) sRGB, the middle of the photograph.
    """

    entry: Entry
    photo: Photo
    linear: Tensor
    valid: Tensor
    scene: Scene
    truth: Tensor


def photographed(entry: Entry) -> Photographed:
    """Decode, rectify and describe a photograph of the pack."""
    photo, setup = entry.photo(), entry.coarse.setup
    linear, valid = rectify(photo, setup, _DETAIL)
    encoding, bank = fit_encoding(linear, valid), FilterBank(FEATURES)
    windows = cut_windows(linear, valid, encoding, bank, _WINDOW)
    scene = Scene(windows, setup, encoding, bank, entry.waves, 2.0 / _DETAIL)
    x, y = _middle(linear)
    truth = srgb(linear[:, y : y + _SIZE, x : x + _SIZE])
    return Photographed(entry, photo, linear, valid, scene, truth)


def capture_once(
    tuned: Photographed,
    shown: Photographed,
    method: str,
    begin: Callable[[], tuple[Decoder, Tensor]],
    steps: int,
) -> Result:
    """Fine-tune to one photograph, and compare with it as it is shown."""
    started = time.perf_counter()
    decoder, code = begin()
    scene = tuned.scene
    if steps:
        found = finetune(decoder, code, scene, TuneSettings(steps=steps), _untold)
        decoder, moments = found.decoder, found.moments
    else:
        moments = tuple(freeze(decoder, code, scene.waves))
    seconds = time.perf_counter() - started
    decoder = decoder.eval().requires_grad_(False)
    material = Material(method, decoder, code, moments, scene.waves, scene.texel_size, scene.setup)
    height, width = tuned.linear.shape[-2:]
    points = plane_points(*_middle(tuned.linear), _SIZE, _SIZE, (width, height), dtype=_FLOAT)
    maps = material.maps(_SIZE, _SIZE, seed=5)
    with torch.inference_mode():
        picture = srgb(render_flash(maps, scene.setup, points))
    style = RandomFilters()
    error = float(difference(style(picture[None]), style(shown.truth[None])))
    return Result(tuned.entry.material, method, error, seconds, picture)


def held_out_results(prior: Prior, entry: Entry, settings: EvaluateSettings) -> list[Result]:
    """The photograph itself, and what comes of it with and without the prior."""
    shown = photographed(entry)

    def from_prior() -> tuple[Decoder, Tensor]:
        return prior.start(shown.photo, entry.coarse, shown.linear, shown.valid)

    def from_nothing() -> tuple[Decoder, Tensor]:
        contrast = log_contrast(shown.linear, shown.valid)
        return untrained(DecoderConfig(), entry.coarse, contrast, 0), torch.zeros(CODE_SIZE)

    few, many = settings.steps, settings.longer
    return [
        Result(entry.material, PHOTOGRAPH, 0.0, 0.0, shown.truth),
        capture_once(shown, shown, "prior, not tuned", from_prior, 0),
        capture_once(shown, shown, f"prior, {few} steps", from_prior, few),
        capture_once(shown, shown, f"nothing, {few} steps", from_nothing, few),
        capture_once(shown, shown, f"nothing, {many} steps", from_nothing, many),
    ]


def _middle(linear: Tensor) -> tuple[int, int]:
    """Left top texel of the square that is compared."""
    return (linear.shape[-1] - _SIZE) // 2, (linear.shape[-2] - _SIZE) // 2


def _untold(share: float, error: float, seconds: float) -> None:
    """Nobody listens."""


def markdown(results: Sequence[Result], tilt_errors: Tensor, prior: Prior, command: str) -> str:
    """The table."""
    methods = [m for m in dict.fromkeys(r.method for r in results) if m != PHOTOGRAPH]
    materials = list(dict.fromkeys(r.material for r in results))
    style = {(r.material, r.method): r.style for r in results}
    lines = [
        "# What the prior is worth",
        "",
        f"Made by `{command}`. Style error of held-out photographs re-rendered under their own",
        "flash, by random filters that no capture optimises: 0 is the same, 2 as unlike as can be.",
        "",
        "| material | " + " | ".join(methods) + " |",
        "|---|" + "---:|" * len(methods),
    ]
    for material in materials:
        cells = " | ".join(f"{style[material, m]:.3f}" for m in methods)
        lines.append(f"| {material} | {cells} |")
    medians = [statistics.median(style[m, method] for m in materials) for method in methods]
    lines.append("| **median** | " + " | ".join(f"**{m:.3f}**" for m in medians) + " |")
    seconds = [
        statistics.median(r.seconds for r in results if r.method == method) for method in methods
    ]
    lines.append("| seconds | " + " | ".join(f"{s:.1f}" for s in seconds) + " |")
    mean, worst = float(tilt_errors.mean()), float(tilt_errors.quantile(0.95))
    lines += [
        "",
        f"Tilt of {len(tilt_errors)} simulated photographs of unseen materials, up to 15 degrees",
        f"either way: mean absolute error {mean:.2f} degrees, 95th percentile {worst:.2f}.",
        "",
        f"Codes of the training photographs: {prior.about.get('dead_dimensions', math.nan)} of",
        f"{CODE_SIZE} dimensions dead.",
        "",
        "![Columns: the materials above. Rows: the columns of the table.](prior-evaluation.png)",
        "",
    ]
    return "\n".join(lines)


def sheet(results: Sequence[Result]) -> np.ndarray:
    """Linear picture: a column a material, a row a method.

    The photographs themselves are left out: they are not ours to publish.
    """
    results = [r for r in results if r.method != PHOTOGRAPH]
    materials = list(dict.fromkeys(r.material for r in results))
    columns = [
        torch.cat([r.picture for r in results if r.material == material], dim=1)
        for material in materials
    ]
    code = torch.cat(columns, dim=2)[:, ::2, ::2].permute(1, 2, 0)
    low, high = code / 12.92, ((code + 0.055) / 1.055) ** 2.4
    return torch.where(code <= 0.04045, low, high).contiguous().numpy()
