"""Evaluation of a prior on held-out photographs, and the variety of its draws.

Pictures of a material are compared in the middle of the photograph, under its own flash: style by
random filters that no capture optimises, colours by XYZ histograms, and diversity of realisations.

They are captured with and without the prior; the photograph as albedo is a baseline. Ablations of
the method are in bench/paper.py.
"""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, zeros

from matcap.brdf.maps import MapSet
from matcap.files.pixels import write_png
from matcap.flash.geometry import FlashSetup, plane_points
from matcap.flash.light import render_flash
from matcap.flash.rectify import Plane, read_plane
from matcap.photo.photo import Photo
from matcap.space.between import blend
from matcap.space.decoder import CODE_SIZE, Decoder, DecoderConfig
from matcap.space.encoder import FEATURES
from matcap.space.prior.store import Prior
from matcap.space.tuned import TunedDecoder
from matcap.space.tuning.finetune import RATE_FROM_NOTHING, RATE_FROM_PRIOR, TuneSettings, finetune
from matcap.space.tuning.match import PhotographTarget, cut_windows, log_contrast, untrained
from matcap.statistics.compare import FilterBank
from matcap_lab.bench.floors import photo_as_albedo
from matcap_lab.experiment.results import Trial, Value, table
from matcap_lab.experiment.runner import Configuration, Experiment, run
from matcap_lab.measures.nsd import style_distance
from matcap_lab.measures.style import (
    RandomFilters,
    StyleStatistics,
    describe_pictures,
    diversity,
    joined,
    srgb_encode_tensor,
    style_distances,
    variety,
    xyz_difference,
)
from matcap_lab.train.corpus import (
    Entry,
    Pack,
    first_of_each,
    lit,
    middle,
    read_code,
    simulated_middle,
    write_grid,
)

ABOUT = (
    "Held-out photographs under their own flash, in their middle. Style: error of the statistics "
    "of random filters that no capture optimises, 0 for the same, at most 2; XYZ: share of the "
    "picture whose colour the photograph does not have; diversity: mean distance between the "
    "features of realisations, place by place, 0 for the same picture, at most 2. The photograph "
    "as albedo is its corner laid in its middle and lit once more."
)
SIZE = 384  # texels a side of the pictures compared
DETAIL = 1024  # texels along the photograph's long side
_WINDOW = 160
_FIRST_SEED = 5
REALISATIONS = 3  # of each material, for diversity
UNSEEN = 1_000_000  # seeds from here on show simulated materials that training never draws
ALBEDO = "photograph as albedo"  # not on the sheet: photographs may not be published


@dataclass(frozen=True)
class Photographed:
    """A photograph of the pack, decoded, rectified, and as the target of fine-tuning."""

    entry: Entry
    photo: Photo
    plane: Plane
    scene: PhotographTarget

    @property
    def middle(self) -> tuple[int, int]:
        """Left top texel (x, y) of the compared square."""
        width, height = self.plane.size
        return (width - SIZE) // 2, (height - SIZE) // 2

    @property
    def truth(self) -> Tensor:
        """(3, SIZE, SIZE) sRGB, the middle of the photograph."""
        x, y = self.middle
        return _shown(self.plane.linear[:, y : y + SIZE, x : x + SIZE])

    def lit(self, maps: MapSet, setup: FlashSetup | None = None) -> Tensor:
        """(3, SIZE, SIZE) sRGB of maps of SIZE texels a side in the middle, under the flash.

        `setup` is the coarse fit's by default.
        """
        points = plane_points(*self.middle, SIZE, SIZE, self.plane.size, dtype=torch.float32)
        with torch.inference_mode():
            return _shown(render_flash(maps, setup or self.scene.setup, points))


def _shown(linear: Tensor) -> Tensor:
    """Code values of a picture."""
    return srgb_encode_tensor(linear.clamp(0.0, 1.0))


def photographed(entry: Entry) -> Photographed:
    """Decode, rectify and describe a photograph of the pack."""
    photo, setup = entry.photo(), entry.coarse.setup
    plane, bank = read_plane(photo, setup, DETAIL), FilterBank(FEATURES)
    windows = cut_windows(plane, bank, _WINDOW)
    scene = PhotographTarget(windows, setup, plane.encoding, bank, entry.waves, plane.texel_size)
    return Photographed(entry, photo, plane, scene)


@dataclass(frozen=True)
class Made:
    """Result of a method on a photograph."""

    pictures: Tensor
    """(N, 3, SIZE, SIZE) sRGB realisations under the photograph's flash."""
    seconds: float
    """Run time of the method, without rendering."""


def compared(shown: Photographed, made: Made) -> Mapping[str, Value]:
    """Errors of a method's pictures against the photograph's, and their diversity."""
    first, truth, style = made.pictures[0], shown.truth, RandomFilters()
    return {
        "seconds": made.seconds,
        "style": style_distance(style, first[None], truth[None]),
        "XYZ": xyz_difference(first, truth),
        "diversity": diversity(made.pictures),
    }


Begin = Callable[[Photographed], tuple[Decoder, Tensor]]
Methods = Mapping[str, Configuration[Photographed, Made]]


def capture(tuned: Photographed, begin: Begin, steps: int, rate: float = RATE_FROM_NOTHING) -> Made:
    """Fine-tune a decoder to a photograph, freeze it, and render some of its realisations."""
    started = time.perf_counter()
    decoder, code = begin(tuned)
    scene = tuned.scene
    outcome = finetune(
        decoder, code, scene, TuneSettings(steps=steps, learning_rate=rate), lambda *_: None
    )
    seconds = time.perf_counter() - started
    if outcome.interrupted:
        raise KeyboardInterrupt  # half a capture is no measurement
    decoder = outcome.decoder.eval().requires_grad_(False)
    frozen = (decoder, code, outcome.moments, scene.waves, scene.texel_size)
    material = TunedDecoder(*frozen).material("", scene.setup)
    seeds = range(_FIRST_SEED, _FIRST_SEED + REALISATIONS)
    pictures = [tuned.lit(material.maps(SIZE, SIZE, seed=seed)) for seed in seeds]
    return Made(torch.stack(pictures), seconds)


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
) -> str:
    """Measure, write prior-evaluation .csv, .md and .jpg, and give the page."""
    entries = first_of_each(pack.reporting)[: settings.materials]
    name, methods = "prior-evaluation", methods_of(prior, settings)
    dead = prior.about.get("dead_dimensions", "?")
    more = f"Codes of the training photographs: {dead} of {CODE_SIZE} dimensions dead."
    return _page(name, measured(name, methods, entries, out, on_progress), out, command, more)


def measured(
    name: str,
    methods: Methods,
    entries: Sequence[Entry],
    out: Path,
    on_progress: Callable[[str], None] = lambda line: None,
) -> list[Trial]:
    """Every method on every photograph; pictures go to a folder of the experiment's name.

    Rows are identified by material and configuration, not by the version of matcap: after
    changing that, or the pack, remove the CSV.
    """

    def pictured(method: str, shown: Photographed, seed: int) -> Made:
        made = methods[method].run(shown, seed)
        path = _picture(out / name, shown.entry.material, method)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_png(path, made.pictures[0].permute(1, 2, 0).numpy(), bits=8)
        return made

    experiment = Experiment(
        name,
        {entry.material: partial(photographed, entry) for entry in entries},
        {method: replace(each, run=partial(pictured, method)) for method, each in methods.items()},
        (compared,),
        any_version=True,
    )
    return run(experiment, out / f"{name}.csv", on_progress)


def methods_of(prior: Prior, settings: EvaluateSettings) -> Methods:
    """From the prior, from nothing, and the photograph as albedo."""
    start, known, few = partial(from_prior, prior), prior_key(prior), settings.steps

    def method(
        begin: Begin, steps: int, rate: float = RATE_FROM_NOTHING
    ) -> Configuration[Photographed, Made]:
        follows = (REALISATIONS, rate, known if begin is start else "")
        return Configuration(lambda shown, _: capture(shown, begin, steps, rate), settings=follows)

    return {
        "prior, not tuned": method(start, 0),
        f"prior, {few} steps": method(start, few, RATE_FROM_PRIOR),
        f"nothing, {few} steps": method(from_nothing, few),
        f"nothing, {settings.longer} steps": method(from_nothing, settings.longer),
        ALBEDO: Configuration(lambda shown, _: albedo(shown)),
    }


def albedo(shown: Photographed) -> Made:
    """The photograph as diffuse albedo: a crop of its corner, moved to the middle.

    An unmoved crop would be compared with itself. There is one picture, so its diversity is 0.
    """
    began = time.perf_counter()
    fixed = photo_as_albedo(shown.photo, shown.scene.setup, DETAIL)
    seconds = time.perf_counter() - began
    return Made(shown.lit(fixed.maps.crop(0, 0, SIZE, SIZE), fixed.setup)[None], seconds)


def from_prior(prior: Prior, shown: Photographed) -> tuple[Decoder, Tensor]:
    """The prior's decoder and its encoder's code of a photograph."""
    return prior.start(shown.photo.pixels, shown.entry.coarse, shown.plane)


def from_nothing(shown: Photographed) -> tuple[Decoder, Tensor]:
    """A random decoder around the coarse fit, and a code of zeros."""
    contrast = log_contrast(shown.plane.linear, shown.plane.valid)
    return untrained(DecoderConfig(), shown.entry.coarse, contrast, 0), zeros(CODE_SIZE)


def prior_key(prior: Prior) -> str:
    """Hash of the networks that a capture starts from, 16 hexadecimal digits."""
    digest = hashlib.sha256()
    for network in (prior.encoder, prior.decoder):
        for name, value in network.state_dict().items():
            digest.update(name.encode() + value.detach().cpu().float().numpy().tobytes())
    return digest.hexdigest()[:16]


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


# Variety and realism of draws from a prior, against held-out photographs.
#
# Draws are rendered in the middle of a photograph's plane under a flash; photographs, held out or
# simulated with seeds that training never draws, are cropped to their middle. All are scaled to the
# same mean radiance and compared by measures/style.py. Interpolations between held-out
# photographs, without fine-tuning, test the latent space: an implausible middle is farther from all
# photographs than the ends are.

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
