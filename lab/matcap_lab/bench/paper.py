"""`matcap-lab bench paper`: the tables of [henzler2021, section 5], for both generators.

Map sets are photographed under a flash near the lens, as the paper does with Mitsuba. Each
configuration captures the photograph; its maps are compared with true samples of the material under
the photograph's own flash (the paper's column *Flash*, which it measures on real photographs) and
under ten other lights (*Relit*), by Gram matrices. Diversity is the mean pairwise distance of
realisations, pixel by pixel; XYZ the difference of colour histograms; seconds those of the
processor, for the capture.

PAPER is the paper's system, FULL matcap's form of it: the decoder reads no drawing, nor
do those of the ablations. SINGLE starts from no prior. NONTUNED does not fine-tune. FOURIER's loss
lacks the power spectrum. GRAM's loss is the Gram matrices alone. LIGHT has no alignment branch. The
paper's DECODERONLY needs a training without an encoder, and is not measured.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from time import process_time
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import COLOURED, DIFFUSE, SPECULAR, MapSet, specular_channels
from matcap.capture.pipeline import capture_photo
from matcap.capture.rectified import Method
from matcap.capture.result import CaptureResult
from matcap.capture.run import read_photograph
from matcap.capture.settings import QUICK_DETAIL, CaptureSettings
from matcap.field.field import computes_bfloat16
from matcap.field.material import Material
from matcap.field.plane import Rectangle
from matcap.flash.geometry import FlashSetup, plane_points
from matcap.flash.light import render_flash
from matcap.space.between import blend
from matcap.space.decoder import ALIGNMENT, DEPTH, maps_from_raw
from matcap.space.freeze import freeze
from matcap.space.prior.store import load_prior
from matcap.space.random_field import Patch, random_field
from matcap.space.tuned import TunedDecoder
from matcap.statistics.compare import FilterBank, FilterBankConfig, Weights, gram, pyramid
from matcap_lab.experiment.results import Mean, Trial, Value, columns_of, markdown, means, shown
from matcap_lab.experiment.runner import Configuration, Experiment
from matcap_lab.measures.evaluator import EvaluationSettings, Evaluator
from matcap_lab.measures.nsd import SqueezeNetStyle, Vgg16Style, style_distance
from matcap_lab.measures.style import (
    RandomFilters,
    Style,
    difference,
    diversity,
    joined,
    mean_pairwise,
    srgb_encode_tensor,
    style_distances,
    xyz_difference,
)
from matcap_lab.simulate.specimen import Specimen, photograph
from matcap_lab.train.corpus import SIZE, lit, lit_maps

DEFAULT, DECODER, FULL, SINGLE = "default", "decoder", "FULL", "SINGLE"
BOTH = "both"
PAPER_FILTERS, PAPER_VGG = "PAPER by filters", "PAPER by VGG-16"
_WHOLE = (DEFAULT, BOTH, DECODER, FULL)
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
    styles: dict[str, Style] = {"style": RandomFilters(), "NSD": SqueezeNetStyle()}
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
        DEFAULT: (CaptureSettings("standard", generator="example"), Method()),
        BOTH: (CaptureSettings("standard"), Method()),
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
            name: Configuration(partial(_compared, captures[name]), asked.generator or BOTH)
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


# Interpolation and generation of `matcap-lab bench paper`: the paper shows pictures, no numbers.
#
# Five steps between two captured materials, under the flash, by `matcap blend` and linear in maps;
# and draws of `matcap sample` beside all map sets of a folder, under one flash at one exposure.

LINEAR, SAMPLE = "linear in maps", "sample"
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
DRAWS = 32
_TEXEL = 2.0 / 1024.0  # of draws, plane units


@dataclass(frozen=True, eq=False)
class PaperSubject:
    """A material, its photograph and true samples (evaluator)."""

    path: Path
    evaluator: Evaluator


PaperCapture = Callable[[PaperSubject, int], tuple[Material, float]]  # by seed; processor seconds
PaperEnds = tuple[PaperSubject, PaperSubject]


def interpolation(
    subjects: Mapping[str, Callable[[], PaperSubject]],
    captures: Mapping[str, PaperCapture],
    settings: object,
) -> Experiment[PaperEnds, Mapping[str, Value]]:
    """Interpolations of each subject and the next one, of the last and the first."""

    def pair(first: str, second: str) -> PaperEnds:
        return subjects[first](), subjects[second]()

    def interpolated(name: str, pair: PaperEnds, seed: int) -> Mapping[str, Value]:
        first, second = (captures[name](subject, seed)[0] for subject in pair)
        evaluator, between = pair[0].evaluator, _linear if name == LINEAR else _blended
        steps = [between(first, second, share, evaluator) for share in SHARES]
        return _lengths(steps, evaluator)

    names = list(subjects)
    ends = zip(names, [*names[1:], *names[:1]], strict=True) if len(names) > 1 else ()
    return Experiment(
        "interpolation",
        {f"{first} to {second}": partial(pair, first, second) for first, second in ends},
        {name: Configuration(partial(interpolated, name)) for name in captures},
        settings=settings,
    )


Lit = tuple[MapSet, tuple[float, float, float]]  # maps and the intensity of their flash


def _blended(first: Material, second: Material, share: float, evaluator: Evaluator) -> Lit:
    material = blend(first, second, share)
    side = evaluator.side(material.texel_size)
    return material.maps(side, side), material.setup.intensity


def _linear(first: Material, second: Material, share: float, evaluator: Evaluator) -> Lit:
    (one, light), (other, light_there) = (
        _blended(first, second, end, evaluator) for end in (0.0, 1.0)
    )
    maps = torch.lerp(_with_colour(one.stacked()), _with_colour(other.stacked()), share)
    red, green, blue = torch.tensor(light).lerp(torch.tensor(light_there), share).tolist()
    return MapSet.from_stacked(maps, one.texel_size), (red, green, blue)


def _lengths(steps: Sequence[Lit], evaluator: Evaluator) -> dict[str, Value]:
    """Distances of the middle and of the longest step, over that of the ends."""
    pictures = [evaluator.relit(maps, light, evaluator.own_scene) for maps, light in steps]
    values: dict[str, Value] = {}
    for name, style in evaluator.styles.items():
        each = [style(picture) for picture in pictures]
        begin, _, middle, _, end = each
        whole = float(difference(begin, end))
        to_ends = max(float(difference(middle, one)) for one in (begin, end))
        longest = max(float(difference(a, b)) for a, b in zip(each, each[1:], strict=False))
        values[f"middle, {name}"] = to_ends / whole
        values[f"longest step, {name}"] = longest / whole
    return values


def generation(
    sets: Sequence[Specimen], styles: Mapping[str, Style], settings: object
) -> Experiment[list[Tensor], list[Tensor]]:
    """Draws of the prior beside map sets."""

    def real() -> list[Tensor]:
        return [lit_maps(one.realise(SIZE, SIZE, _TEXEL), FlashSetup()).float() for one in sets]

    def drawn(_: list[Tensor], seed: int) -> list[Tensor]:
        prior = load_prior()
        return [lit(prior.draw(seed * DRAWS + number)) for number in range(DRAWS)]

    def compared(real: list[Tensor], made: list[Tensor]) -> Mapping[str, Value]:
        values: dict[str, Value] = {}
        for name, style in styles.items():
            true, ours = (joined([style(one[None]) for one in each]) for each in (real, made))
            within = style_distances(true, true)
            closest = within.clone().fill_diagonal_(float("inf")).min(1).values.mean()
            nearest = style_distances(ours, true).min(1).values.mean()
            values[f"nearest, {name}"] = float(nearest / closest)
            between = mean_pairwise(style_distances(ours, ours))
            values[f"spread, {name}"] = between / mean_pairwise(within)
        return values

    subject = {f"{len(sets)} map sets": real}
    return Experiment(
        "generation", subject, {SAMPLE: Configuration(drawn)}, (compared,), settings=settings
    )


# The paper's own fine-tuning [henzler2021, sec. 4.3 and 4.5], a baseline; slow.
#
# It starts from the prior at the photograph's code. A step decodes new noise for the whole picture,
# renders it, and compares crops of rendering and photograph at one random place and scale: L1
# differences of the features' Gram matrices, plus 1e-3 times those of their power spectra.
#
# As the paper's published program has it and its text does not: pictures continue by reflection,
# and amplitudes stand for power. Different from the paper: crops have VGG's 224 x 224 pixels, as in
# the text, not 512 x 384, as in the program; VGG-16 or random filters; the prior is matcap's.

STEPS = 1000
RATE, DECAY = 1e-3, 1e-5  # ten times the rate of its training, and its weight decay
SPECTRUM = 1e-3  # lambda
SCALES = (0.1, 8.0)  # picture texels per pixel of a crop
CROP = 224  # pixels

ImageFeatures = Callable[[Tensor], list[Tensor]]  # of sRGB pictures (B, 3, H, W)


def random_features() -> ImageFeatures:
    """Random filters on a pyramid in VGG's place; values from 0 to 255, as VGG-16 reads them."""
    bank = FilterBank(FilterBankConfig(sizes=(3, 5, 9), filters=48))
    return lambda pictures: [bank.features(level) for level in pyramid(255.0 * pictures, 5)]


def finetuned_as_in_paper(
    untuned: CaptureResult, features: ImageFeatures, seed: int, steps: int = STEPS
) -> Material:
    """Fine-tune an untuned capture by the decoder, without a drawing, as the paper does.

    The photograph is in landscape format; features are VGG's or random ones; `seed` is of noise,
    places and scales; `steps` are Adam's.
    """
    start = untuned.material.part(TunedDecoder)
    assert start is not None
    setup = untuned.material.setup
    height, width = (side // ALIGNMENT * ALIGNMENT for side in untuned.rectified.shape[:2])
    pixels = torch.from_numpy(untuned.rectified[:height, :width].copy()).permute(2, 0, 1)[None]
    points = plane_points(0, 0, width, height, untuned.rectified.shape[1::-1], dtype=torch.float32)
    seen = (pixels > 0.0).any(1, keepdim=True)
    decoder = copy.deepcopy(start.decoder).requires_grad_(True)
    optimiser = torch.optim.Adam(decoder.parameters(), RATE, weight_decay=DECAY)
    generator = torch.Generator().manual_seed(seed)
    area, config = Rectangle(0, 0, width, height), decoder.config
    for step in range(steps):
        patch = Patch(seed + step, area, period=(width, height))
        field = random_field(patch, config.noise_channels, (), levels=DEPTH, cells=config.cells)
        with torch.autocast("cpu", torch.bfloat16, enabled=computes_bfloat16()):
            raw = decoder(field, start.code)
        maps = maps_from_raw(raw.float(), start.texel_size, periodic=True)
        rendered = torch.where(seen, render_flash(maps, setup, points[None]), pixels)
        both = srgb_encode_tensor(torch.cat([rendered, pixels]).clamp(1e-4, 1.0))
        loss = _difference(features, crop(both, generator))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    decoder.requires_grad_(False)
    moments = tuple(freeze(decoder, start.code, ()))
    tuned = TunedDecoder(decoder, start.code, moments, (), start.texel_size)
    return tuned.material(untuned.material.name, setup)


def crop(pictures: Tensor, generator: torch.Generator) -> Tensor:
    """(B, 3, CROP, CROP) of pictures (B, 3, H, W), all at one random place and scale."""
    low, high = SCALES
    place_x, place_y, scale = torch.rand(3, generator=generator).tolist()
    scale = low + (high - low) * scale
    if scale > 1.0:  # a Gaussian of 5 texels against aliasing
        kernel = torch.exp(-0.5 * (torch.arange(-2.0, 3.0) * 3.0 / scale).square())
        kernel = (kernel / kernel.sum()).expand(3, 1, 1, 5)
        for weight in (kernel, kernel.transpose(2, 3)):
            sides = (2, 2, 0, 0) if weight is kernel else (0, 0, 2, 2)
            pictures = F.conv2d(F.pad(pictures, sides, "reflect"), weight, groups=3)
    height, width = pictures.shape[-2:]
    along = scale * torch.arange(CROP)
    x = 2.0 * (along + 2.0 * width * place_x) / (width - 1) - 1.0
    y = 2.0 * (along + 2.0 * height * place_y) / (height - 1) - 1.0
    grid = torch.stack([x.expand(CROP, CROP), y[:, None].expand(CROP, CROP)], dim=-1)
    grid = grid.expand(len(pictures), -1, -1, -1)
    return F.grid_sample(pictures, grid, padding_mode="reflection", align_corners=True)


def _difference(features: ImageFeatures, pair: Tensor) -> Tensor:
    """Difference between two pictures (2, 3, H, W), the second one fixed."""
    rendered, photographed = pair.contiguous(memory_format=torch.channels_last).split(1)
    with torch.autocast("cpu", torch.bfloat16, enabled=computes_bfloat16()):
        with torch.no_grad():
            target = features(photographed)
        made = features(rendered)
    total = torch.zeros(())
    for ours, theirs in zip(made, target, strict=True):
        total = total + (gram(ours) - gram(theirs))[:, :-1, :-1].abs().mean()
        powers = [torch.fft.rfft2(level.float()).abs() for level in (ours, theirs)]
        total = total + SPECTRUM * (powers[0] - powers[1]).abs().mean()
    return total


def _with_colour(stacked: Tensor) -> Tensor:
    """Stacked maps with F0 in three channels, (..., 8, H, W): one channel is repeated."""
    if specular_channels(stacked.shape[-3]) == COLOURED:
        return stacked
    grey = stacked[..., SPECULAR, :, :]
    rest = stacked[..., SPECULAR.stop :, :, :]
    return torch.cat([stacked[..., DIFFUSE, :, :], grey, grey, grey, rest], dim=-3)
