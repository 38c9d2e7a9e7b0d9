"""`matcap-lab bench paper`: the tables of [henzler2021, section 5], for both generators.

Map sets are photographed under a flash near the lens, as the paper does with Mitsuba. Each
configuration captures the photograph; its maps are compared with true samples of the material under
the photograph's own flash (the paper's column *Flash*, which it measures on real photographs) and
under ten other lights (*Relit*), by Gram matrices. Diversity is the mean pairwise distance of
realisations, pixel by pixel; XYZ the difference of colour histograms; seconds those of the
processor, for the capture.

PAPER is the paper's system (paper.py), FULL matcap's form of it: the decoder reads no drawing, nor
do those of the ablations. SINGLE starts from no prior. NONTUNED does not fine-tune. FOURIER's loss
lacks the power spectrum. GRAM's loss is the Gram matrices alone. LIGHT has no alignment branch. The
paper's DECODERONLY needs a training without an encoder; `matcap-lab prior ablate` has the nearest
equivalent. Interpolation and generation: paper_space.py.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from time import process_time
from typing import Any

import torch
from torch import Tensor

from matcap.capture.method import Method
from matcap.capture.pipeline import capture_photo, read_photograph
from matcap.capture.settings import QUICK_DETAIL, CaptureSettings
from matcap.field.material import Material
from matcap.statistics.compare import Weights
from matcap_lab.bench.paper import STEPS, ImageFeatures, finetuned_as_in_paper, random_features
from matcap_lab.bench.paper_space import (
    LINEAR,
    PaperCapture,
    PaperSubject,
    generation,
    interpolation,
)
from matcap_lab.experiment.results import Mean, Trial, Value, columns_of, markdown, means, shown
from matcap_lab.experiment.runner import Configuration, Experiment
from matcap_lab.measures.evaluator import EvaluationSettings, Evaluator
from matcap_lab.measures.nsd import style_distance
from matcap_lab.measures.paper_metrics import diversity, xyz_difference
from matcap_lab.measures.style import RandomFilters, Style
from matcap_lab.measures.vgg16 import Vgg16Style
from matcap_lab.simulate.specimen import Specimen, photograph

DEFAULT, DECODER, FULL, SINGLE = "default", "decoder", "FULL", "SINGLE"
PAPER_FILTERS, PAPER_VGG = "PAPER by filters", "PAPER by VGG-16"
_WHOLE = (DEFAULT, DECODER, FULL)
_PAPERS = (PAPER_FILTERS, PAPER_VGG)  # of few materials, as one takes twenty minutes
_ABOUT = """\
*style*: relative L1 difference of statistics of random filters that no capture optimises; *VGG-16*:
that of Gram matrices of VGG-16 (0: the same, at most 2; the paper leaves open which VGG, layers and
scale); *NSD*: by SqueezeNet, over that of two true samples. *flash*: under the photograph's own
flash; *relit*: under ten other lights. *diversity*: mean pairwise distance of realisations, at most
2. *XYZ*: share of the picture whose colour the truth does not have. *processor*: seconds. *of*:
number of materials, pairs or sets. *middle*, *longest step*: style distance of the middle to the
farther end, and of the longest of four steps, over that of the ends. *nearest*: of a draw to the
nearest map set, over that of a map set to the nearest other one; *spread*: mean of two draws, over
that of two map sets."""
# The paper's tables 2 and 3: style under the flash, relit, diversity; and errors beside FULL's.
PAPER: Mapping[str, tuple[str, str, str]] = {
    "the paper's own": ("0.597", "0.439", "2.08"),
    "its rivals, best": ("0.545", "0.512", "0.00"),
}
PAPER_ABLATIONS: Mapping[str, str] = {
    SINGLE: "-0.5 %", "NONTUNED": "+24.0 %", "FOURIER": "+0.9 %", "LIGHT": "+1.7 %",
}  # fmt: skip


EVALUATION = EvaluationSettings(every=1, truths=2)  # the plane's middle, all ten lights
REALISATIONS = 3  # for diversity


def paper_experiments(
    subjects: Sequence[Specimen],
    sets: Sequence[Specimen],
    out: Path,
    steps: int | None = None,
    weights: Path | None = None,
) -> list[Experiment[Any, Any]]:
    """The tables, interpolation and generation.

    Args:
        subjects: materials captured.
        sets: map sets that draws are compared with.
        out: folder for photographs.
        steps: of fine-tuning; None for those of the preset `standard`, and the paper's.
        weights: of VGG-16; None leaves it out.

    Raises:
        MatcapError: the weights of VGG-16 cannot be read.
    """
    styles: dict[str, Style] = {"style": RandomFilters(), "NSD": EVALUATION.squeezenet}
    papers = {PAPER_FILTERS: random_features()}
    if weights is not None:
        styles["VGG-16"] = vgg16 = Vgg16Style(weights)
        papers[PAPER_VGG] = vgg16.features

    def prepare(subject: Specimen) -> PaperSubject:
        path, shot = photograph(subject, EVALUATION.camera, out)
        return PaperSubject(path, Evaluator(subject, shot.setup, EVALUATION, styles))

    decoder = CaptureSettings("standard", steps, generator="decoder")
    full = replace(decoder, drawing=False)
    untuned = replace(full, steps=0)
    variants: dict[str, tuple[CaptureSettings, Method]] = {
        DEFAULT: (CaptureSettings("standard"), Method()),
        DECODER: (decoder, Method()),
        FULL: (full, Method()),
        SINGLE: (replace(full, prior="none"), Method()),
        "NONTUNED": (untuned, Method()),
        "FOURIER": (full, Method(weights=Weights(spectrum=0.0))),
        "GRAM": (full, Method(weights=Weights(cross=0.0, spectrum=0.0, histogram=0.0))),
        "LIGHT": (full, Method(measured_tilt=False)),
        **dict.fromkeys(papers, (replace(untuned, detail=QUICK_DETAIL), Method())),
    }
    captures = {
        name: _capture(asked, method, papers.get(name), steps or STEPS)
        for name, (asked, method) in variants.items()
    }
    prepared = {subject.name: cache(partial(prepare, subject)) for subject in subjects}
    settings = (steps, weights, EVALUATION, REALISATIONS)
    tables = Experiment(
        "paper",
        prepared,
        {
            name: Configuration(partial(_compared, captures[name]), asked.generator)
            for name, (asked, _) in variants.items()
        },
        settings=settings,
    )
    interpolated = {name: captures[name] for name in (DEFAULT, DECODER, FULL, SINGLE)}
    interpolated[LINEAR] = captures[DEFAULT]
    return [
        tables,
        interpolation(prepared, interpolated, settings),
        generation(sets, styles, settings),
    ]


def _capture(
    asked: CaptureSettings, method: Method, features: ImageFeatures | None, steps: int
) -> PaperCapture:
    """A configuration's captures, each made once; with features, fine-tuned as in the paper."""

    @cache
    def captured(subject: PaperSubject, seed: int) -> tuple[Material, float]:
        chosen, began = replace(asked, seed=seed), process_time()
        result = capture_photo(read_photograph(subject.path, chosen), chosen, method=method)
        material = result.material
        if features is not None:
            material = finetuned_as_in_paper(result, features, seed, steps)
        return material, process_time() - began

    return captured


def _compared(capture: PaperCapture, subject: PaperSubject, seed: int) -> Mapping[str, Value]:
    """Distances of a capture to true samples; by SqueezeNet, over those between true samples."""
    (material, spent), evaluator = capture(subject, seed), subject.evaluator
    side, intensity = evaluator.side(material.texel_size), material.setup.intensity
    maps = [material.maps(side, side, seed=seed) for seed in range(REALISATIONS)]
    scene = evaluator.own_scene
    flash = torch.cat([evaluator.relit(each, intensity, scene) for each in maps])
    lights, true = evaluator.relit(maps[0], intensity), evaluator.relit_truths(scene)
    values: dict[str, Value] = {}
    for name, style in evaluator.styles.items():
        if name != "NSD":
            values[f"{name}, flash"] = _distance(style, flash[:1], true)
            values[f"{name}, relit"] = _distance(style, lights, evaluator.pictures)
    return {
        **values,
        "NSD, relit": evaluator.style_ratio(lights, "NSD"),
        "diversity": diversity(flash),
        "XYZ": xyz_difference(flash[0], true[0][0]),
        "processor": spent,
    }


def _distance(style: Style, pictures: Tensor, truths: Sequence[Tensor]) -> float:
    """Mean style distance to the true samples."""
    return sum(style_distance(style, pictures, truth) for truth in truths) / len(truths)


def paper_page(rows: Sequence[Trial], command: str) -> str:
    """The paper's two tables in Markdown, with the paper's own figures, and those of its space."""
    captured, interpolated, drawn = (
        [row for row in rows if row.experiment == name]
        for name in ("paper", "interpolation", "generation")
    )
    averages = means([row for row in captured if row.configuration not in _PAPERS], FULL)
    whole = [mean for mean in averages if mean.configuration in _WHOLE]
    style = "VGG-16, relit" if "VGG-16, relit" in columns_of(captured) else "style, relit"
    published = [[name, *values] for name, values in PAPER.items()]
    parts = (
        "# The paper's tables",
        f"Measured by `{command}`.",
        _ABOUT,
        _table("generator", whole, columns_of(captured)),
        *_paper_system(captured),
        "The paper's table 2, for its own method and for the best of its five rivals:",
        "\n".join(markdown(["", "style, flash", "style, relit", "diversity"], published)),
        "**Another metric, other materials: not comparable** with the figures above.",
        f"## Ablations, by {style}",
        _ablations([mean for mean in averages if mean not in whole], whole, style),
        "## Interpolation",
        _table("between two materials", means(interpolated), columns_of(interpolated)),
        "## Generation",
        _table("materials", means(drawn), columns_of(drawn)),
    )
    return "\n\n".join(parts) + "\n"


def _paper_system(captured: Sequence[Trial]) -> list[str]:
    """The paper's system and matcap's generators, on the materials that it was measured on."""
    subjects = {row.subject for row in captured if row.configuration in _PAPERS}
    if not subjects:
        return []
    names = (*_WHOLE, *_PAPERS)
    rows = [row for row in captured if row.subject in subjects and row.configuration in names]
    return [
        f"On {', '.join(sorted(subjects))} alone, where the paper's system was measured:",
        _table("generator", means(rows, FULL), columns_of(captured)),
    ]


def _table(head: str, averages: Sequence[Mean], columns: Sequence[str]) -> str:
    """Means with the number of subjects, in the columns that have any, without wall time."""
    given = {name for name in columns for mean in averages if not math.isnan(mean[name])}
    columns = [name for name in columns if name in given - {"seconds"}]
    lines = [
        [mean.configuration, f"{mean.subjects}", *(shown(mean[column]) for column in columns)]
        for mean in averages
    ]
    return "\n".join(markdown([head, "of", *columns], lines))


def _ablations(ablated: Sequence[Mean], whole: Sequence[Mean], style: str) -> str:
    """Changes against FULL, beside the paper's."""
    full = {mean.configuration: mean[style] for mean in whole}.get(FULL, math.nan)
    lines = [
        [
            mean.configuration,
            shown(mean[style]),
            f"{100.0 * (mean[style] / full - 1.0):+.1f} %",
            PAPER_ABLATIONS.get(mean.configuration, "not measured"),
        ]
        for mean in ablated
    ]
    head = ["ablation of the decoder", style, "against FULL", "in the paper"]
    return "\n".join(markdown(head, lines))
