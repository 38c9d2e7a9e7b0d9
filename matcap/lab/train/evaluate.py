"""Evaluation of a prior and ablations, on held-out photographs.

*Evaluation*: held-out photographs captured with and without the prior, and the photograph as albedo
as a baseline. *Ablation* (paper, section 5.4): FULL starts from the prior and fine-tunes. SINGLE
starts from random weights. NONTUNED does not fine-tune. DECODERONLY starts from random weights and
has no downsampling path (decoder_only.py); compare it with SINGLE. FOURIER fine-tunes without the
power spectrum. LIGHT assumes a tilt of 0 (in the paper: no alignment branch).
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, zeros

from matcap.files.png import write_png
from matcap.lab.bench.methods import photo_as_albedo
from matcap.lab.experiment.results import Trial, Value, table
from matcap.lab.experiment.runner import Configuration, Experiment, run
from matcap.lab.train.decoder_only import DecoderOnly
from matcap.lab.train.measure import (
    DETAIL,
    SIZE,
    Made,
    Photographed,
    capture,
    compared,
    photographed,
)
from matcap.lab.train.pack import Entry, Pack, first_of_each, read_code
from matcap.lab.train.pictures import write_grid
from matcap.space.decoder import CODE_SIZE, Decoder, DecoderConfig
from matcap.space.prior.store import Prior
from matcap.space.tuning.finetune import RATE_FROM_NOTHING, RATE_FROM_PRIOR
from matcap.space.tuning.start import log_contrast, untrained
from matcap.statistics.compare import Weights

ABOUT = (
    "Held-out photographs under their own flash, in their middle. Style: error of the statistics "
    "of random filters that no capture optimises, 0 for the same, at most 2; XYZ: share of the "
    "picture whose colour the photograph does not have; diversity: mean distance between the "
    "features of realisations, place by place, 0 for the same picture, at most 2. The photograph "
    "as albedo is its corner laid in its middle and lit once more."
)
REALISATIONS = 3  # of each material, for diversity
UNSEEN = 1_000_000  # seeds from here on show simulated materials that training never draws
ALBEDO = "photograph as albedo"  # which is not ours to publish: not on the sheet

Begin = Callable[[Photographed], tuple[Decoder, Tensor]]
Ways = Mapping[str, Configuration[Photographed, Made]]


@dataclass(frozen=True)
class EvaluateSettings:
    """Steps and numbers of photographs."""

    steps: int = 100
    """Fine-tuning steps from the prior."""

    longer: int = 1000
    """Fine-tuning steps from random weights."""

    materials: int = 12
    """Number of held-out materials."""


def run_evaluation(
    prior: Prior,
    pack: Pack,
    settings: EvaluateSettings,
    out: Path,
    command: str,
    on_progress: Callable[[str], None] = lambda line: None,
    *,
    ablation: bool = False,
) -> str:
    """Measure, write prior-evaluation (or prior-ablation) .csv, .md and .jpg, and give the page."""
    entries = first_of_each(pack.reporting)[: settings.materials]
    if ablation:
        name, more = "prior-ablation", ""
        ways = variants(prior, settings.steps)
    else:
        name, ways = "prior-evaluation", ways_of(prior, settings)
        dead = prior.about.get("dead_dimensions", "?")
        more = f"Codes of the training photographs: {dead} of {CODE_SIZE} dimensions dead."
    return _page(name, measured(name, ways, entries, out, on_progress), out, command, more)


def measured(
    name: str,
    ways: Ways,
    entries: Sequence[Entry],
    out: Path,
    on_progress: Callable[[str], None] = lambda line: None,
) -> list[Trial]:
    """Every method on every photograph; pictures go to a folder of the experiment's name.

    Rows are identified by material and configuration, not by the version of matcap: after
    changing that, or the pack, remove the CSV.
    """

    def picture(shown: Photographed, made: Made) -> Mapping[str, Value]:
        path = _picture(out / name, shown.entry.material, made.method)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_png(path, made.pictures[0].permute(1, 2, 0).numpy(), bits=8)
        return {}

    def named(
        method: str, way: Configuration[Photographed, Made]
    ) -> Configuration[Photographed, Made]:
        return replace(way, run=lambda s, seed: replace(way.run(s, seed), method=method))

    experiment = Experiment(
        name,
        {entry.material: partial(photographed, entry) for entry in entries},
        {method: named(method, way) for method, way in ways.items()},
        (compared, picture),
        any_version=True,
    )
    return run(experiment, out / f"{name}.csv", on_progress)


def ways_of(prior: Prior, settings: EvaluateSettings) -> Ways:
    """From the prior, from nothing, and the photograph as albedo."""
    start, known, few = partial(from_prior, prior), prior_key(prior), settings.steps

    def way(
        begin: Begin, steps: int, rate: float = RATE_FROM_NOTHING
    ) -> Configuration[Photographed, Made]:
        follows = (REALISATIONS, rate, known if begin is start else "")
        return Configuration(
            lambda shown, _: capture(shown, partial(begin, shown), steps, REALISATIONS, rate),
            settings=follows,
        )

    return {
        "prior, not tuned": way(start, 0),
        f"prior, {few} steps": way(start, few, RATE_FROM_PRIOR),
        f"nothing, {few} steps": way(from_nothing, few),
        f"nothing, {settings.longer} steps": way(from_nothing, settings.longer),
        ALBEDO: Configuration(lambda shown, _: albedo(shown)),
    }


def variants(prior: Prior, steps: int) -> Ways:
    """FULL and its ablations."""
    start, known = partial(from_prior, prior), prior_key(prior)

    def way(
        begin: Begin,
        view: Callable[[Photographed], Photographed] = lambda shown: shown,
        taken: int = steps,
    ) -> Configuration[Photographed, Made]:
        rate = RATE_FROM_PRIOR if begin is start else RATE_FROM_NOTHING

        def made(shown: Photographed, _seed: int) -> Made:
            # Every variant is compared with the photograph as it is, however it sees it itself.
            tuned = view(shown)
            return capture(tuned, partial(begin, tuned), taken, REALISATIONS, rate)

        return Configuration(made, settings=(taken, REALISATIONS, known if begin is start else ""))

    return {
        "FULL": way(start),
        "SINGLE": way(from_nothing),
        "NONTUNED": way(start, taken=0),
        "DECODERONLY": way(partial(from_nothing, kind=DecoderOnly)),
        "FOURIER": way(start, _without_spectrum),
        "LIGHT": way(start, _without_tilt),
    }


def albedo(shown: Photographed) -> Made:
    """The photograph as diffuse albedo: a crop of its corner, moved to the middle.

    An unmoved crop would be compared with itself. There is one picture, so its diversity is 0.
    """
    began = time.perf_counter()
    fixed = photo_as_albedo(shown.photo, shown.scene.setup, DETAIL)
    seconds = time.perf_counter() - began
    corner = fixed.maps.crop(0, 0, SIZE, SIZE)
    return Made(shown.lit(corner, fixed.setup)[None], seconds)


def from_prior(prior: Prior, shown: Photographed) -> tuple[Decoder, Tensor]:
    """The prior's decoder and its encoder's code of a photograph."""
    return prior.start(shown.photo.pixels, shown.entry.coarse, shown.plane)


def from_nothing(shown: Photographed, kind: type[Decoder] = Decoder) -> tuple[Decoder, Tensor]:
    """A random decoder around the coarse fit, and a code of zeros."""
    contrast = log_contrast(shown.plane.linear, shown.plane.valid)
    return untrained(DecoderConfig(), shown.entry.coarse, contrast, 0, kind), zeros(CODE_SIZE)


def prior_key(prior: Prior) -> str:
    """Hash of the networks that a capture starts from, 16 hexadecimal digits."""
    digest = hashlib.sha256()
    for network in (prior.encoder, prior.decoder):
        for name, value in network.state_dict().items():
            digest.update(name.encode() + value.detach().cpu().float().numpy().tobytes())
    return digest.hexdigest()[:16]


def _without_spectrum(shown: Photographed) -> Photographed:
    return replace(shown, scene=replace(shown.scene, weights=Weights(spectrum=0.0)))


def _without_tilt(shown: Photographed) -> Photographed:
    coarse = shown.entry.coarse
    straight = replace(coarse, setup=replace(coarse.setup, tilt=(0.0, 0.0)))
    return photographed(replace(shown.entry, coarse=straight))


def _page(name: str, rows: Sequence[Trial], out: Path, command: str, more: str) -> str:
    """Write the table as a page, and a sheet: a column for each material, a row for each method."""
    methods = [m for m in dict.fromkeys(row.configuration for row in rows) if m != ALBEDO]
    materials = list(dict.fromkeys(row.subject for row in rows))
    paths = [_picture(out / name, material, m) for m in methods for material in materials]
    write_grid([_read(path) for path in paths], len(materials), out / f"{name}.jpg")
    sheet = f"![Columns: the materials. Rows: {', '.join(methods)}.]({name}.jpg)"
    text = f"{table(rows, command, ABOUT)}\n{more}\n\n{sheet}\n"
    (out / f"{name}.md").write_text(text, encoding="utf-8")
    return text


def _picture(folder: Path, material: str, method: str) -> Path:
    return folder / f"{material}, {method}.png"


def _read(path: Path) -> Tensor:
    """(3, H, W) sRGB in [0, 1]; black if the file is missing after an interrupted run."""
    if not path.is_file():
        return torch.zeros(3, SIZE, SIZE)
    code = read_code(path.read_bytes(), path.name)[..., ::-1]
    return torch.from_numpy(np.ascontiguousarray(code.transpose(2, 0, 1))).float() / 255.0
