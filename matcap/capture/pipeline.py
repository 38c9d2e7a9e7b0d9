"""The whole way from a photograph to a material. This file reads as its data flow."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.anytime import self_difference
from matcap.capture.audition import begin
from matcap.capture.coarse import CoarseFit, fit_coarse, under_flash
from matcap.capture.detail import plane_in_detail
from matcap.capture.exemplar.find import FoundExemplar, find_exemplar
from matcap.capture.exemplar.store import load_inverse
from matcap.capture.finetune import Tuned, TuneScene, TuneSettings, finetune
from matcap.capture.joint import join
from matcap.capture.match import match_photograph
from matcap.capture.progress import CaptureClock, CaptureProgress
from matcap.capture.settings import CaptureSettings, Effort, Method, Statistics, resolve
from matcap.capture.start import logits
from matcap.capture.verdict.judge import CaptureVerdict, verdict_on
from matcap.capture.windows import cut_windows
from matcap.errors import MatcapError
from matcap.files.interrupts import postponed
from matcap.flash.plane import Plane
from matcap.flash.render import render_rectified
from matcap.model.decoder import ALIGNMENT
from matcap.model.material import Material
from matcap.photo.load import load_photo
from matcap.photo.photo import Photo
from matcap.photo.refusals import SHORTEST_SIDE
from matcap.statistics.compare import Features
from matcap.statistics.filterbank import FilterBank
from matcap.statistics.vgg import Vgg19

_FOR_EXEMPLAR = 0.6  # share of a time limit


@dataclass(frozen=True)
class CaptureResult:
    """A material and how it came about.

    Attributes:
        photo: what was captured; the first one of several.
        material: the generator.
        rectified: (H, W, 3) the photograph on the plane's grid, linear.
        rerendered: (H, W, 3) the material under the photograph's own flash, linear.
        maps: of that same rectangle.
        history: (seconds, step, error) of fine-tuning.
        stage_seconds: per stage.
        settings: as given.
        interrupted: ended by Ctrl-C, with the best so far.
        self_difference: error between neighbouring windows of the photograph; NaN if it has none.
        found: maps of the photographed piece, where they were asked for.
    """

    photo: Photo
    material: Material
    rectified: NDArray[np.float32]
    rerendered: NDArray[np.float32]
    maps: MapSet
    history: tuple[tuple[float, int, float], ...]
    stage_seconds: dict[str, float]
    settings: CaptureSettings
    interrupted: bool
    self_difference: float = math.nan
    found: FoundExemplar | None = None

    @cached_property
    def verdict(self) -> CaptureVerdict:
        """How good it is, in words; takes about a second the first time."""
        return verdict_on(self)


def read_photograph(
    path: str | Path, settings: CaptureSettings, method: Method | None = None
) -> Photo:
    """A photograph as a capture with these settings, done so, needs it.

    Raises:
        UsageError: an unknown preset.
        MatcapError: the file is not a photograph that can be read.
    """
    # What is compared with the photograph must know its noise.
    noise = _compares(settings, resolve(settings, method))
    return load_photo(path, long_side=settings.most_detail, fov=settings.fov, noise=noise)


def capture_file(
    path: str | Path,
    settings: CaptureSettings,
    progress: Callable[[CaptureProgress], None] | None = None,
) -> CaptureResult:
    """A photograph's file to a material; see read_photograph and capture_photo."""
    return capture_photo(read_photograph(path, settings), settings, progress)


def capture_photo(
    photo: Photo,
    settings: CaptureSettings,
    progress: Callable[[CaptureProgress], None] | None = None,
    method: Method | None = None,
    others: Sequence[Photo] = (),
) -> CaptureResult:
    """A photograph to a material; or several of one sample, tuned to all of them together.

    Args:
        photo: as read_photograph gives it.
        settings: what the user decides.
        progress: called as the work goes on.
        method: how to do it; the best known way unless told otherwise.
        others: more photographs of the same sample (joint.py); the result shows the first.

    Raises:
        UsageError: an unknown preset.
        MatcapError: a photograph nothing can be made of, or a prior that cannot be read.
    """
    method = method or Method()
    effort, limit = resolve(settings, method), settings.time_limit
    clock = CaptureClock(progress)

    with clock.stage("coarse fit"):
        coarse = under_flash(fit_coarse(photo), photo.flash_intensity)

    with clock.stage("statistics"):
        plane, lattice = plane_in_detail(photo, coarse.setup, settings.detail)
        bank = _features(settings.statistics, method)
        window = _window(plane, method.window, photo.name)
        most = None if _compares(settings, effort) else 1
        scene = TuneScene(
            cut_windows(plane, bank, window, most=most),
            coarse.setup,
            plane.encoding,
            bank,
            lattice.waves,
            plane.texel_size,
            expected=logits(coarse),
        )
        scene, joined = join(scene, coarse, others, plane.size[0]) if others else (scene, [])
        own = clock.scale = self_difference(scene.windows, scene.weights)

    with clock.stage("start"):
        beginning = begin(photo, coarse, plane, scene, settings, effort, method)

    with clock.stage("fine-tuning"):
        tune = TuneSettings(
            steps=effort.steps,
            seconds=limit and limit * (1.0 - _FOR_EXEMPLAR * settings.finds_exemplar),
            target=_target(settings, own, photo.name),
            places=effort.places,
            learning_rate=beginning.rate,
            half_precision=method.half_precision,
            seed=settings.seed,
        )
        tuned = finetune(beginning.decoder, beginning.code, scene, tune, clock.tuning)

    provenance = _provenance(photo, settings, coarse, effort.steps, joined)
    material = _material(photo, tuned, beginning.code, scene, provenance)
    if tuned.history and effort.matched:
        # To the first photograph, if there are others.
        with clock.stage("matching"), postponed() as stop:
            material = match_photograph(material, plane, settings.seed)
        tuned = replace(tuned, interrupted=tuned.interrupted or stop())

    found = None
    if settings.finds_exemplar:
        with clock.stage("exemplar"):
            found = _piece(plane, coarse, scene, tuned, effort, settings, clock)
    if found is not None and settings.generator == "example":
        material = replace(material, example=found.example)

    with clock.stage("rendering"), postponed() as stop:
        maps = material.maps(*plane.size, seed=settings.seed)
        with torch.inference_mode():
            rerendered = render_rectified(maps, material.setup)

    return CaptureResult(
        photo=photo,
        material=material,
        rectified=_picture(plane.linear),
        rerendered=_picture(rerendered),
        maps=maps,
        history=tuned.history,
        stage_seconds=clock.seconds,
        settings=settings,
        interrupted=tuned.interrupted or stop() or (found is not None and found.interrupted),
        self_difference=own,
        found=found,
    )


def _piece(
    plane: Plane,
    coarse: CoarseFit,
    scene: TuneScene,
    tuned: Tuned,
    effort: Effort,
    settings: CaptureSettings,
    clock: CaptureClock,
) -> FoundExemplar:
    """The photographed piece's own maps; in a hurry after an interrupt, and whole all the same."""
    limit = settings.time_limit

    def find(steps: int) -> FoundExemplar:
        return find_exemplar(
            plane,
            coarse,
            load_inverse(),
            scene,
            steps=steps,
            seconds=limit and limit * _FOR_EXEMPLAR,
            seed=settings.seed,
            tell=clock.finding,
        )

    try:
        if not tuned.interrupted:
            return find(effort.adapted)
    except KeyboardInterrupt:
        pass
    with postponed():
        return replace(find(0), interrupted=True)


def _compares(settings: CaptureSettings, effort: Effort) -> bool:
    """Whether anything is going to be compared with the photograph."""
    return effort.steps > 0 or (settings.finds_exemplar and effort.adapted > 0)


def _features(statistics: Statistics, method: Method) -> Features:
    """What textures are compared by."""
    weights = statistics.weights
    return FilterBank(method.features) if weights is None else Vgg19.load(weights)


def _target(settings: CaptureSettings, own: float, name: str) -> float | None:
    """The error to end at, beside the photograph's own."""
    if settings.target is not None and math.isnan(own):
        raise MatcapError(
            "the picture is too small to be compared with itself",
            where=name,
            remedy="raise --detail, or give --steps or --time in place of --target",
        )
    return None if settings.target is None else settings.target * own


def _window(plane: Plane, wanted: int, name: str) -> int:
    """Window size that fits the picture, a multiple of the decoder's alignment."""
    width, height = plane.size
    if min(height, width) < SHORTEST_SIDE:
        raise MatcapError(
            f"at this detail the picture is {width} x {height} texels, too few to hold a texture",
            where=name,
            remedy=f"raise --detail, or crop it, until both are at least {SHORTEST_SIDE}",
        )
    return min(wanted, *(side // ALIGNMENT * ALIGNMENT for side in (height, width)))


def _material(
    photo: Photo, tuned: Tuned, code: Tensor, scene: TuneScene, provenance: dict[str, Any]
) -> Material:
    return Material(
        name=photo.name.rsplit(".", 1)[0] or photo.name,
        decoder=tuned.decoder.eval().requires_grad_(False),
        code=code,
        moments=tuned.moments,
        waves=scene.waves,
        texel_size=scene.texel_size,
        setup=scene.setup,
        provenance=provenance,
    )


def _picture(linear: Tensor) -> NDArray[np.float32]:
    picture: NDArray[np.float32] = linear.permute(1, 2, 0).contiguous().numpy()
    return picture


def _provenance(
    photo: Photo,
    settings: CaptureSettings,
    coarse: CoarseFit,
    steps: int,
    joined: list[dict[str, Any]],
) -> dict[str, Any]:
    told: dict[str, Any] = {
        "photograph": photo.name,
        "settings": settings.named(),
        "millimetres_per_unit": settings.millimetres_per_unit,
        "steps": steps,
        "coarse": {
            "diffuse": list(coarse.diffuse),
            "specular": coarse.specular,
            "roughness": coarse.roughness,
            "residual": coarse.residual,
            "lobes": [list(lobe) for lobe in coarse.lobes],
        },
    }
    return told | ({"others": joined} if joined else {})
