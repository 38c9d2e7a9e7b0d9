"""The whole way from a photograph to a material. This file reads as its data flow."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.anytime import forecast, self_difference
from matcap.capture.coarse import CoarseFit, fit_coarse
from matcap.capture.detail import DETAIL, detail_for
from matcap.capture.finetune import (
    RATE_FROM_NOTHING,
    RATE_FROM_PRIOR,
    Scene,
    TuneSettings,
    finetune,
)
from matcap.capture.joint import join
from matcap.capture.match import match_photograph
from matcap.capture.prior.store import load_prior
from matcap.capture.start import log_contrast, logits, reading_cells, untrained
from matcap.capture.windows import cut_windows
from matcap.errors import MatcapError, UsageError
from matcap.flash.geometry import FlashSetup, plane_points
from matcap.flash.rectify import rectify, rectify_noise
from matcap.flash.render import render_flash
from matcap.model.decoder import ALIGNMENT, CODE_SIZE, Decoder, DecoderConfig
from matcap.model.material import Material
from matcap.model.order import CELL_CHANNELS
from matcap.photo.photo import Photo
from matcap.photo.refusals import SHORTEST_SIDE
from matcap.statistics.compare import Features
from matcap.statistics.encoding import fit_encoding
from matcap.statistics.filterbank import FilterBank, FilterBankConfig
from matcap.statistics.lattice import find_lattice
from matcap.statistics.vgg import Vgg19

FEATURES = FilterBankConfig(sizes=(5,), filters=64)
_FORECAST_EVERY = 20  # steps
# From nothing, where a run ends depends on where it starts: the best of a few short runs goes on.
_AUDITIONS, _AUDITION_STEPS = 3, 40


@dataclass(frozen=True)
class Effort:
    """What a preset spends.

    Attributes:
        steps: of fine-tuning.
        places: windows a step; all see the same maps, so one more costs a fifth more.
        matched: mean and contrast moved to the photograph's at the end (match.py).
    """

    steps: int
    places: int = 2
    matched: bool = True


# docs/notes/capture.md has what each costs and buys.
PRESETS: Mapping[str, Effort] = MappingProxyType(
    {
        "instant": Effort(0),
        "draft": Effort(32, matched=False),
        "standard": Effort(160, places=3),
        "high": Effort(320, places=3),
        "reference": Effort(800),
    }
)


@dataclass(frozen=True)
class CaptureSettings:
    """What the user decides.

    Attributes:
        preset: a key of PRESETS.
        steps: of fine-tuning, instead of the preset's.
        time_limit: of fine-tuning in seconds, or None.
        target: error to end at, as a multiple of what the photograph's own windows differ by.
        detail: texels across the photograph's long side; by default DETAIL, or half of it where
            the texture is coarse (detail.py).
        fov: field of view across the long side in degrees, instead of the photograph's.
        seed: of everything random.
        prior: "auto" (the one that comes with matcap), "none" (start from nothing) or a file.
        statistics: that textures are compared by: "filterbank", or "vgg19=FILE" with
            torchvision's weights.
    """

    preset: str = "standard"
    steps: int | None = None
    time_limit: float | None = None
    target: float | None = None
    detail: int | None = None
    fov: float | None = None
    seed: int = 0
    prior: str = "auto"
    statistics: str = "filterbank"

    @property
    def most_detail(self) -> int:
        """Texels along the long side that a photograph has to be read with."""
        return self.detail or DETAIL

    @property
    def tunes(self) -> bool:
        """Whether anything is compared with the photograph, whose noise must be known then."""
        return _steps(self) > 0


@dataclass(frozen=True)
class Method:
    """How it is done: nothing that users decide, but what `matcap bench capture` measures.

    Attributes:
        window: texels a side of what is compared; many cheap steps beat few exact ones.
        features: that textures are compared by.
        decoder: shape of the decoder, where there is no prior to say it.
        half_precision: bfloat16 inside the network and the features.
        places: windows a step, instead of the preset's.
        matched: at the end, instead of as the preset says.
    """

    window: int = 160
    features: FilterBankConfig = FEATURES
    decoder: DecoderConfig = DecoderConfig()
    half_precision: bool = True
    places: int | None = None
    matched: bool | None = None


@dataclass(frozen=True)
class Progress:
    """How far a capture is.

    Attributes:
        stage: its name.
        fraction: of the stage, in [0, 1].
        error: running error of fine-tuning, or None.
        seconds: since the start.
        seconds_left: expected, or None.
        in_a_minute: error to be expected if it went on for another minute, or None.
    """

    stage: str
    fraction: float
    error: float | None
    seconds: float
    seconds_left: float | None
    in_a_minute: float | None = None


@dataclass(frozen=True)
class CaptureResult:
    """A material and how it came about.

    Attributes:
        material: the generator.
        rectified: (H, W, 3) the photograph on the plane's grid, linear.
        rerendered: (H, W, 3) the material under the photograph's own flash, linear.
        maps: of that same rectangle.
        history: (seconds, step, error) of fine-tuning.
        stage_seconds: per stage.
        settings: as given.
        interrupted: ended by Ctrl-C, with the best so far.
        self_difference: error between neighbouring windows of the photograph; NaN if it has none.
    """

    material: Material
    rectified: NDArray[np.float32]
    rerendered: NDArray[np.float32]
    maps: MapSet
    history: tuple[tuple[float, int, float], ...]
    stage_seconds: dict[str, float]
    settings: CaptureSettings
    interrupted: bool
    self_difference: float = math.nan


def capture_photo(
    photo: Photo,
    settings: CaptureSettings,
    progress: Callable[[Progress], None] | None = None,
    method: Method | None = None,
    others: Sequence[Photo] = (),
) -> CaptureResult:
    """A photograph to a material; or several of one sample, tuned to all of them together.

    Args:
        photo: as load_photo gives it.
        settings: what the user decides.
        progress: called as the work goes on.
        method: how to do it; the best known way unless told otherwise.
        others: more photographs of the same sample (joint.py); the result shows the first.

    Raises:
        UsageError: an unknown preset.
        MatcapError: a photograph nothing can be made of, or a prior that cannot be read.
    """
    steps = _steps(settings)
    method = method or Method()
    effort = _effort(settings)
    places = method.places or effort.places
    matched = effort.matched if method.matched is None else method.matched
    clock = _Clock(progress)

    with clock.stage("coarse fit"):
        coarse = _with_known_flash(fit_coarse(photo), photo.flash_intensity)

    with clock.stage("statistics"):
        detail = settings.most_detail
        linear, valid = rectify(photo, coarse.setup, detail)
        noise = rectify_noise(photo, coarse.setup, detail)
        encoding = fit_encoding(linear, valid, noise)
        lattice = find_lattice(encoding(linear[None])[0], valid)
        if settings.detail is None and not lattice.waves:
            # A lattice is told to the network outright, however long its period.
            suited = detail_for(linear, valid)
            if suited != detail:
                detail = suited
                linear, valid = rectify(photo, coarse.setup, detail)
                noise = rectify_noise(photo, coarse.setup, detail)
                encoding = fit_encoding(linear, valid, noise)
        bank = _features(settings.statistics, method)
        windows = cut_windows(
            linear,
            valid,
            encoding,
            bank,
            _window(linear, method.window, photo.name),
            noise=noise,
            most=None if steps else 1,  # nothing will be compared
        )
        texel_size = 2.0 / linear.shape[-1]
        scene = Scene(
            windows,
            coarse.setup,
            encoding,
            bank,
            lattice.waves,
            texel_size,
            expected=logits(coarse),
        )
        scene, joined = join(scene, coarse, others, detail) if others else (scene, [])
        windows = scene.windows
        own = self_difference(windows, scene.weights)
        target = _target(settings, own, photo.name)

    with clock.stage("start"):
        if settings.prior == "none":
            rate = RATE_FROM_NOTHING
            code = torch.zeros(CODE_SIZE)
            contrast = log_contrast(linear, valid)
            cells = CELL_CHANNELS if lattice.waves else 0
            method = replace(method, decoder=replace(method.decoder, cells=cells))
            decoder = _audition(coarse, contrast, code, scene, settings, steps, places, method)
        else:
            rate = RATE_FROM_PRIOR
            prior = load_prior(None if settings.prior == "auto" else Path(settings.prior))
            decoder, code = prior.start(photo, coarse, linear, valid)
            if lattice.waves and steps:  # untuned, its weights would only add noise
                decoder = reading_cells(decoder, settings.seed)
            decoder.requires_grad_(True)

    with clock.stage("fine-tuning"):
        tuned = finetune(
            decoder,
            code,
            scene,
            TuneSettings(
                steps=steps,
                seconds=settings.time_limit,
                target=target,
                places=places,
                learning_rate=rate,
                half_precision=method.half_precision,
                seed=settings.seed,
            ),
            clock.tuning,
        )

    material = Material(
        name=_stem(photo.name),
        decoder=tuned.decoder.eval().requires_grad_(False),
        code=code,
        moments=tuned.moments,
        waves=lattice.waves,
        texel_size=texel_size,
        setup=coarse.setup,
        provenance=_provenance(photo, settings, coarse, steps)
        | ({"others": joined} if joined else {}),
    )
    if tuned.history and matched:
        with clock.stage("matching"):  # to the first photograph, if there are others
            material = match_photograph(material, linear, valid, encoding, noise, settings.seed)

    with clock.stage("rendering"):
        height, width = linear.shape[-2:]
        maps = material.maps(width, height, seed=settings.seed)
        rerendered = _flash_picture(maps, material.setup)

    return CaptureResult(
        material=material,
        rectified=_picture(linear),
        rerendered=_picture(rerendered),
        maps=maps,
        history=tuned.history,
        stage_seconds=clock.seconds,
        settings=settings,
        interrupted=tuned.interrupted,
        self_difference=own,
    )


def _with_known_flash(coarse: CoarseFit, intensity: float | None) -> CoarseFit:
    """The same picture under the flash that a calibration card told: albedo becomes absolute."""
    if intensity is None:
        return coarse
    dimmer = coarse.setup.intensity[1] / intensity
    red, green, blue = (min(value * dimmer, 0.98) for value in coarse.diffuse)
    return replace(
        coarse,
        diffuse=(red, green, blue),
        specular=min(coarse.specular * dimmer, 0.98),
        setup=coarse.setup.with_intensity((intensity,) * 3),
    )


def _steps(settings: CaptureSettings) -> int:
    effort = _effort(settings)
    return effort.steps if settings.steps is None else settings.steps


def _effort(settings: CaptureSettings) -> Effort:
    if settings.preset not in PRESETS:
        raise UsageError(
            f"there is no preset {settings.preset!r}", remedy=f"choose one of {', '.join(PRESETS)}"
        )
    # A time limit or a target alone decides when to stop.
    limited = settings.time_limit is not None or settings.target is not None
    alone = limited and settings.steps is None
    return PRESETS["reference" if alone else settings.preset]


def _features(statistics: str, method: Method) -> Features:
    """What textures are compared by."""
    name, _, path = statistics.partition("=")
    if name == "vgg19" and path:
        return Vgg19.load(Path(path))
    if statistics != "filterbank":
        raise UsageError(
            f"there are no statistics {statistics!r}",
            remedy="choose filterbank, or vgg19=FILE with torchvision's weights",
        )
    return FilterBank(method.features)


def _target(settings: CaptureSettings, own: float, name: str) -> float | None:
    """The error to end at, beside the photograph's own."""
    if settings.target is not None and math.isnan(own):
        raise MatcapError(
            "the picture is too small to be compared with itself",
            where=name,
            remedy="raise --detail, or give --steps or --time in place of --target",
        )
    return None if settings.target is None else settings.target * own


def _window(linear: Tensor, wanted: int, name: str) -> int:
    """Window size that fits the picture, a multiple of the decoder's alignment."""
    height, width = linear.shape[-2:]
    if min(height, width) < SHORTEST_SIDE:
        raise MatcapError(
            f"at this detail the picture is {width} x {height} texels, too few to hold a texture",
            where=name,
            remedy=f"raise --detail, or crop it, until both are at least {SHORTEST_SIDE}",
        )
    return min(wanted, *(side // ALIGNMENT * ALIGNMENT for side in (height, width)))


def _audition(
    coarse: CoarseFit,
    contrast: Tensor,
    code: Tensor,
    scene: Scene,
    settings: CaptureSettings,
    steps: int,
    places: int,
    method: Method,
) -> Decoder:
    """The most promising of a few random decoders, each tuned for a moment.

    Skipped when there is no time for it: the first one goes on then.
    """
    seeds = range(settings.seed, settings.seed + _AUDITIONS)
    if steps < 4 * _AUDITIONS * _AUDITION_STEPS or settings.time_limit is not None:
        return untrained(method.decoder, coarse, contrast, settings.seed)
    best, least = None, math.inf
    for seed in seeds:
        tune = TuneSettings(
            steps=_AUDITION_STEPS,
            places=places,
            learning_rate=RATE_FROM_NOTHING,
            half_precision=method.half_precision,
            seed=seed,
        )
        tried = finetune(
            untrained(method.decoder, coarse, contrast, seed), code, scene, tune, _untold
        )
        error = tried.history[-1][2] if tried.history else math.inf
        if best is None or error < least:
            best, least = tried.decoder, error
        if tried.interrupted:
            raise KeyboardInterrupt
    assert best is not None
    return best


def _untold(share: float, error: float, seconds: float) -> None:
    """Nobody listens to an audition."""


def _flash_picture(maps: MapSet, setup: FlashSetup) -> Tensor:
    width, height = maps.size
    points = plane_points(0, 0, width, height, (width, height), dtype=torch.float32)
    with torch.inference_mode():
        return render_flash(maps, setup, points)


def _picture(linear: Tensor) -> NDArray[np.float32]:
    picture: NDArray[np.float32] = linear.permute(1, 2, 0).contiguous().numpy()
    return picture


def _stem(name: str) -> str:
    return name.rsplit(".", 1)[0] or name


def _provenance(
    photo: Photo, settings: CaptureSettings, coarse: CoarseFit, steps: int
) -> dict[str, Any]:
    return {
        "photograph": photo.name,
        "settings": asdict(settings),
        "steps": steps,
        "coarse": {
            "diffuse": list(coarse.diffuse),
            "specular": coarse.specular,
            "roughness": coarse.roughness,
            "residual": coarse.residual,
        },
    }


class _Clock:
    """Times the stages and tells the caller how far things are."""

    def __init__(self, progress: Callable[[Progress], None] | None) -> None:
        self.seconds: dict[str, float] = {}
        self._progress = progress
        self._started = time.monotonic()
        self._history: list[tuple[float, int, float]] = []
        self._ahead: float | None = None

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        began = time.monotonic()
        self._tell(Progress(name, 0.0, None, began - self._started, None))
        yield
        self.seconds[name] = time.monotonic() - began
        self._tell(Progress(name, 1.0, None, time.monotonic() - self._started, None))

    def tuning(self, share: float, error: float, seconds: float) -> None:
        left = seconds * (1.0 - share) / share if share > 0.01 else None
        elapsed = time.monotonic() - self._started
        self._history.append((seconds, len(self._history) + 1, error))
        if len(self._history) % _FORECAST_EVERY == 0:
            self._ahead = forecast(self._history, 60.0)
        self._tell(Progress("fine-tuning", share, error, elapsed, left, self._ahead))

    def _tell(self, progress: Progress) -> None:
        if self._progress is not None:
            self._progress(progress)
