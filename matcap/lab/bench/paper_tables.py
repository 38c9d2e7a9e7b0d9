"""`matcap bench paper`: the tables of [henzler2021, section 5], for both generators.

Map sets are photographed under a flash near the lens, as the paper does with Mitsuba. Each
configuration captures the photograph; its maps are compared with true samples of the material under
the photograph's own flash (the paper's column *Flash*, which it measures on real photographs) and
under ten other lights (*Relit*), by Gram matrices. Diversity is the mean pairwise distance of
realisations, pixel by pixel; XYZ the difference of colour histograms; seconds those of capture and
synthesis.

FULL is the paper's method: its decoder reads no drawing, nor do those of the ablations. SINGLE
starts from no prior. NONTUNED does not fine-tune. FOURIER's loss lacks the power spectrum. GRAM's
loss is the Gram matrices alone. LIGHT has no alignment branch. The paper's DECODERONLY needs a
training without an encoder; `matcap prior ablate` has the nearest equivalent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import torch
from torch import Tensor

from matcap.capture.method import Method
from matcap.capture.pipeline import capture_photo, read_photograph
from matcap.capture.result import CaptureResult
from matcap.capture.settings import CaptureSettings
from matcap.lab.experiment.results import Trial, Value, markdown, means, shown
from matcap.lab.experiment.runner import Configuration, Experiment
from matcap.lab.measures.evaluator import EvaluationSettings, Evaluator
from matcap.lab.measures.lights import BenchScene
from matcap.lab.measures.nsd import style_distance
from matcap.lab.measures.paper_metrics import diversity, xyz_difference
from matcap.lab.measures.style import RandomFilters, Style
from matcap.lab.measures.vgg16 import Vgg16Style
from matcap.lab.simulate.specimen import Specimen, photograph
from matcap.statistics.compare import Weights

DEFAULT, DECODER, FULL = "default", "decoder", "FULL"
# The paper's tables 2 and 3: style under the flash, relit, diversity; and errors beside FULL's.
PAPER: Mapping[str, tuple[str, str, str]] = {
    "the paper's own": ("0.597", "0.439", "2.08"),
    "its rivals, best": ("0.545", "0.512", "0.00"),
}
PAPER_ABLATIONS: Mapping[str, str] = {
    "SINGLE": "-0.5 %", "NONTUNED": "+24.0 %", "FOURIER": "+0.9 %", "LIGHT": "+1.7 %",
}  # fmt: skip


@dataclass(frozen=True)
class PaperSettings:
    """Steps, styles and sizes of the tables."""

    steps: int | None = None
    """Fine-tuning steps; None for those of the preset `standard`."""

    vgg16: Path | None = None
    """Weights of VGG-16; None leaves its columns out."""

    realisations: int = 3
    """Number of realisations for diversity."""

    evaluation: EvaluationSettings = field(
        default_factory=lambda: EvaluationSettings(every=1, truths=2)
    )
    """Sizes and lights: the middle of the plane, under all ten lights."""


@dataclass(frozen=True)
class PaperSubject:
    """A material, its photograph and true samples (evaluator)."""

    name: str
    path: Path
    evaluator: Evaluator
    styles: Mapping[str, Style]


@dataclass(frozen=True)
class PaperPictures:
    """Pictures of a configuration's maps, (L, 3, H, W) each."""

    flash: Tensor
    """Each realisation under the photograph's own flash."""

    lights: Tensor
    """The first realisation under ten lights."""


def paper_experiment(
    subjects: Sequence[Specimen], out: Path, settings: PaperSettings
) -> Experiment[PaperSubject, PaperPictures]:
    """The default, the paper's generator and its ablations on each subject.

    Raises:
        MatcapError: the weights of VGG-16 cannot be read.
    """
    styles: dict[str, Style] = {"style": RandomFilters()}
    if settings.vgg16 is not None:
        styles["VGG-16"] = Vgg16Style(settings.vgg16)

    def prepare(subject: Specimen) -> Callable[[], PaperSubject]:
        def prepared() -> PaperSubject:
            path, shot = photograph(subject, settings.evaluation.camera, out)
            evaluator = Evaluator(subject, shot.setup, settings.evaluation, styles)
            return PaperSubject(subject.name, path, evaluator, styles)

        return prepared

    asked = CaptureSettings("standard", settings.steps)
    decoder = replace(asked, generator="decoder")
    full = replace(decoder, drawing=False)
    ways: dict[str, tuple[CaptureSettings, Method]] = {
        DEFAULT: (CaptureSettings("standard"), Method()),
        DECODER: (decoder, Method()),
        FULL: (full, Method()),
        "SINGLE": (replace(full, prior="none"), Method()),
        "NONTUNED": (replace(full, steps=0), Method()),
        "FOURIER": (full, Method(weights=Weights(spectrum=0.0))),
        "GRAM": (full, Method(weights=Weights(cross=0.0, spectrum=0.0, histogram=0.0))),
        "LIGHT": (full, Method(measured_tilt=False)),
    }
    return Experiment(
        "paper",
        {subject.name: prepare(subject) for subject in subjects},
        {
            name: Configuration(_captured(asked, method, settings), group=asked.generator)
            for name, (asked, method) in ways.items()
        },
        (_styles, _diversity_and_colour),
        settings=settings,
    )


def _captured(
    asked: CaptureSettings, method: Method, settings: PaperSettings
) -> Callable[[PaperSubject, int], PaperPictures]:
    def run(subject: PaperSubject, seed: int) -> PaperPictures:
        chosen = replace(asked, seed=seed)
        result = capture_photo(read_photograph(subject.path, chosen), chosen, method=method)
        return _relit(result, subject.evaluator, settings.realisations)

    return run


def _relit(result: CaptureResult, evaluator: Evaluator, count: int) -> PaperPictures:
    material = result.material
    side, intensity = evaluator.side(material.texel_size), material.setup.intensity
    maps = [material.maps(side, side, seed=seed) for seed in range(count)]
    own = evaluator.own_scene
    return PaperPictures(
        torch.cat([evaluator.relit(each, intensity, own) for each in maps]),
        evaluator.relit(maps[0], intensity),
    )


def _styles(subject: PaperSubject, made: PaperPictures) -> Mapping[str, Value]:
    """Style distances to true samples, and the same normalised by those between true samples."""
    evaluator, own = subject.evaluator, subject.evaluator.own_scene
    values: dict[str, Value] = {}
    for name, style in subject.styles.items():
        values[f"{name}, flash"] = _distance(style, made.flash[:1], evaluator, own)
        values[f"{name}, relit"] = _distance(style, made.lights, evaluator, evaluator.scene)
    first = next(iter(subject.styles))
    values["style ratio, relit"] = evaluator.style_ratio(made.lights, first)
    return values


def _distance(style: Style, pictures: Tensor, evaluator: Evaluator, scene: BenchScene) -> float:
    """Mean style distance to the true samples."""
    truths = evaluator.pictures if scene == evaluator.scene else evaluator.relit_truths(scene)
    each = [style_distance(style, pictures, truth) for truth in truths]
    return sum(each) / len(each)


def _diversity_and_colour(subject: PaperSubject, made: PaperPictures) -> Mapping[str, Value]:
    true = subject.evaluator.relit_truths(subject.evaluator.own_scene)[0][0]
    return {"diversity": diversity(made.flash), "XYZ": xyz_difference(made.flash[0], true)}


def paper_page(rows: Sequence[Trial], command: str) -> str:
    """The paper's two tables in Markdown, with the paper's own figures."""
    by_name = {mean.configuration: mean for mean in means(rows)}
    columns = list(dict.fromkeys(name for row in rows for name in row.values))
    subjects = len({row.subject for row in rows})
    head = ["generator", *columns]
    lines = [
        [name, *(shown(by_name[name][column]) for column in columns)]
        for name in (DEFAULT, DECODER, FULL)
        if name in by_name
    ]
    style = (
        "VGG-16, relit" if any("VGG-16, relit" in row.values for row in rows) else "style, relit"
    )
    ablations = []
    if FULL in by_name:
        full = by_name[FULL][style]
        for name, mean in by_name.items():
            if name not in (DEFAULT, DECODER, FULL):
                change = 100.0 * (mean[style] / full - 1.0)
                published = PAPER_ABLATIONS.get(name, "not measured")
                ablations.append([name, shown(mean[style]), f"{change:+.1f} %", published])
    return "\n".join(
        [
            "# The paper's tables",
            "",
            f"Measured by `{command}` on {subjects} materials, means over them.",
            "",
            "*style* is the relative L1 difference of statistics of random filters that no",
            "capture optimises, *VGG-16* that of Gram matrices of VGG-16 (0: the same, at most 2;",
            "the paper leaves open which VGG, layers and scale). *style ratio*: *style* over that",
            "of two true samples. *diversity*: mean pairwise distance of realisations, at most 2.",
            "*XYZ*: share of the picture whose colour the truth does not have. *flash*: under the",
            "photograph's own flash; *relit*: under ten other lights.",
            "",
            *markdown(head, lines),
            "",
            "The paper's table 2, for its own method and for the best of its five rivals:",
            "",
            *markdown(
                ["", "style, flash", "style, relit", "diversity"],
                [[name, *values] for name, values in PAPER.items()],
            ),
            "",
            "**Another metric, other materials: not comparable** with the figures above.",
            "",
            f"## Ablations, by {style}",
            "",
            *markdown(
                ["ablation of the decoder", style, "against FULL", "in the paper"], ablations
            ),
            "",
        ]
    )
