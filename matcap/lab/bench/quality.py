"""`matcap bench quality`: appearance error of captures under new lights.

Each procedural material is photographed, each method makes maps of the photograph, and these are
relit and compared with other true samples by Portilla-Simoncelli statistics and random filters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from matcap.files.picture import write_picture
from matcap.files.srgb import srgb_decode_tensor
from matcap.flash.geometry import FlashSetup
from matcap.lab.bench.methods import (
    CapturedMaps,
    capture_exemplar,
    exemplar_maps,
    field_maps,
    photo_as_albedo,
)
from matcap.lab.experiment.results import Value
from matcap.lab.experiment.runner import Configuration, Experiment, choose
from matcap.lab.measures.evaluator import EvaluationSettings, Evaluator
from matcap.lab.measures.style import PortillaSimoncelli, RandomFilters, Style
from matcap.lab.simulate.photograph import as_photo
from matcap.lab.simulate.specimen import EXAMPLES, Specimen, photograph
from matcap.photo.photo import Photo

ABOUT = (
    "Normalised style distance of relit maps to other true samples, over ten point lights away "
    "from the flash; 1 is indistinguishable. PS: Portilla-Simoncelli statistics; RF: random "
    "filters unknown to capture (matcap/lab/measures/style.py); mean: of both."
)
DECODER, ALBEDO = "decoder", "photo-as-albedo"
EXEMPLAR, BY_EXAMPLE = "exemplar", "by-example"
METHODS = (DECODER, EXEMPLAR, BY_EXAMPLE, ALBEDO)


@dataclass(frozen=True)
class Judged:
    """A photograph, its true camera and flash, and true samples (evaluator)."""

    path: Path
    """Its DNG, the only input of captures."""

    photo: Photo
    """The photograph in memory."""

    setup: FlashSetup
    """True camera and flash."""

    evaluator: Evaluator
    columns: dict[str, Tensor] = field(default_factory=dict)
    """Pictures by method, truth first, for the sheet."""


def quality_experiment(
    capture: Callable[[Path], CapturedMaps],
    out: Path,
    *,
    materials: Sequence[str] = (),
    methods: Sequence[str] = METHODS,
    settings: EvaluationSettings | None = None,
    captured: object = None,
) -> Experiment[Judged, Tensor]:
    """Every method on every material; photographs and sheets go to `out`.

    Args:
        capture: function of a DNG's path, the method DECODER.
        out: folder for the photographs (DNG) and for the relit pictures side by side (PNG).
        materials: names in EXAMPLES; all by default.
        methods: names in METHODS.
        settings: sizes, lights and true samples.
        captured: settings of `capture`; rows of other settings are measured again.

    Raises:
        UsageError: no such material or method.
    """
    wanted = settings or EvaluationSettings(detail=1024, size=384)
    evaluation = replace(wanted, finer=2, every=1, first=1001)
    detail = evaluation.detail
    makers: Mapping[str, Callable[[Judged], CapturedMaps]] = {
        DECODER: lambda judged: capture(judged.path),
        EXEMPLAR: lambda judged: exemplar_maps(capture_exemplar(judged.path, detail)),
        BY_EXAMPLE: lambda judged: field_maps(
            capture_exemplar(judged.path, detail).material, evaluation.width
        ),
        ALBEDO: lambda judged: photo_as_albedo(judged.photo, judged.setup, detail),
    }
    chosen = choose(makers, methods)

    styles: dict[str, Style] = {
        "PS": PortillaSimoncelli((evaluation.size,) * 2),
        "RF": RandomFilters(),
    }

    def prepare(specimen: Specimen) -> Judged:
        path, shot = photograph(specimen, evaluation.camera, out)
        evaluator = Evaluator(specimen, shot.setup, evaluation, styles)
        photo = as_photo(shot, specimen.seed, path.name)
        truth = {"truth": evaluator.pictures[0]}
        return Judged(path, photo, shot.setup, evaluator, truth)

    def run(method: str, judged: Judged, _seed: int) -> Tensor:
        made, evaluator = chosen[method](judged), judged.evaluator
        pictures = evaluator.relit(evaluator.middle(made.maps), made.setup.intensity)
        judged.columns[method] = pictures
        return pictures

    return Experiment(
        "quality",
        {name: partial(prepare, one) for name, one in choose(EXAMPLES, materials).items()},
        {method: Configuration(partial(run, method)) for method in chosen},
        (style_ratios, sheet),
        settings=(evaluation, captured),
    )


def style_ratios(judged: Judged, pictures: Tensor) -> Mapping[str, Value]:
    """Style ratio by each style (NSD by SqueezeNet), and their mean."""
    evaluator = judged.evaluator
    distances = {name: evaluator.style_ratio(pictures, name) for name in evaluator.styles}
    return {**distances, "mean": sum(distances.values()) / len(distances)}


def sheet(judged: Judged, _pictures: Tensor) -> Mapping[str, Value]:
    """Write a sheet, no column: a row for every third light; truth first, then each method."""
    rows = [torch.cat(list(row), dim=2) for row in zip(*judged.columns.values(), strict=True)]
    linear = srgb_decode_tensor(torch.cat(rows[::3], dim=1))
    path = judged.path.with_suffix(".png")
    write_picture(linear.permute(1, 2, 0).contiguous().numpy(), path)
    return {}
