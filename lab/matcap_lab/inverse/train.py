"""Training of the inverse network in runs that continue one another exactly.

A step trains on simulated photographs; samples are a pure function of their numbers, prefetched by
worker processes. train/trainer.py runs the steps. The shipped weights are the running average.
"""

from __future__ import annotations

import json
import math
import multiprocessing
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing.pool import AsyncResult
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.cook_torrance import Reflectance, SurfaceParameters, dot
from matcap.brdf.maps import normals_from_height
from matcap.capture.exemplar.network.network import (
    FORMAT,
    VERSION,
    ExpectedErrors,
    Inverse,
    InverseConfig,
    NetworkAnswer,
    read_inverse,
)
from matcap.capture.exemplar.predict import seen_colour, specular_tint
from matcap.errors import MatcapError
from matcap.files.tensors import write_tensors
from matcap.files.threads import compute_alone
from matcap.flash.light import FlashLight
from matcap.statistics.compare import FilterBank, FilterBankConfig, gram, pyramid
from matcap_lab.inverse.samples import HELD_OUT, REAL_SHARE, Sample, draw_sample, training_sets
from matcap_lab.measures.evaluator import spherical
from matcap_lab.simulate.varied import HELD_OUT_PATTERNS
from matcap_lab.train.trainer import CHECKPOINT, RateSchedule, Reporting, Training, fit

# Losses of the inverse network.
#
# Errors of the maps; of renderings under new lights [deschaintre2018], which weight errors by their
# visibility; of local band energies of slope and albedo, and of statistics of relit pictures,
# because L1 alone shrinks uncertain values to their mean; and a likelihood of the predicted errors.
# A step's pictures are evaluated at once, as tensors alone, so that all between the network and the
# statistics can be compiled.

_LEVELS = 5  # of the pyramid on which slopes are compared
_CELLS = 48  # texels a side of the cells whose energies are compared
_FLAT = 0.02  # root-mean-square slope, below which energies are not distinguished
_PLAIN = 0.02  # likewise of log albedo
BLACK = 0.02  # albedo: darker ones differ little to the eye
DARKEST = 0.01  # radiance, of a white plane's
LEAST_ERROR = 0.01  # added to errors before their logarithm, which the network predicts
_MOST_F0 = 0.99
_THIN = 2  # stride in texels of pictures under the near light, whose highlight lies anywhere
# Filters for relit pictures, other than those of captures and of their evaluation.
_BANK = FilterBank(FilterBankConfig(sizes=(5,), filters=20, levels=4, seed=91))
_WHITE = 0.35  # mean radiance that pictures are scaled to for their statistics

Parts = dict[str, Tensor]
Compare = Callable[..., tuple[Parts, Tensor, Tensor]]  # `compared`, or that compiled


# Weights of the loss's parts.
WEIGHTS: Mapping[str, float] = MappingProxyType(
    {
        "albedo": 1.0, "specular": 0.3, "roughness": 0.5, "slope": 0.5, "energy": 0.5,
        "render": 1.0, "style": 1.0, "doubt": 0.1, "metal": 0.2,
    }
)  # fmt: skip


@dataclass(frozen=True)
class WantedOutputs:
    """Targets of a step's pictures, stacked."""

    truth: Tensor
    """(B, OUTPUTS, H, W) the network's target."""
    metal: Tensor
    """(B, 1, H, W) true share that is metal."""
    hue: Tensor
    """(B, 3, H, W) true F0 over the mean of its channels."""
    seen: Tensor
    """(B, 3, H, W) the photograph's colour, the specular tint of texels predicted as metal."""
    base: Tensor
    """(B, OUTPUTS, 1, 1) the coarse fit, to which outputs are relative."""
    points: Tensor
    """(3, H, W) plane points, common to all."""
    camera: Tensor
    """(B, 3, 1, 1) positions of the cameras."""
    near: Tensor
    far: Tensor
    """(B, 3, 1, 1) positions of a light with its mirror point in view, and a far one."""


def wanted(
    samples: Sequence[Sample], rng: np.random.Generator, device: str = "cpu"
) -> WantedOutputs:
    """Targets of samples of one size, and randomly drawn lights, on a device."""
    lights = [_lights(s, rng) for s in samples]
    samples = [s.to(device) for s in samples]
    points = samples[0].points
    places = [(0.0, 0.0, s.uniform.setup.distance) for s in samples]

    def column(vectors: Sequence[Sequence[float]]) -> Tensor:
        return torch.tensor(vectors).to(points)[..., None, None]

    return WantedOutputs(
        torch.stack([s.residuals.stacked() for s in samples]),
        torch.stack([s.metal for s in samples]),
        torch.stack([s.truth.specular / s.truth.specular.mean(0) for s in samples]),
        torch.stack([seen_colour(s.linear, s.valid[None]) for s in samples]),
        torch.stack([s.uniform.parameters().stacked() for s in samples]).to(points),
        points,
        column(places),
        column([near for near, _ in lights]),
        column([far for _, far in lights]),
    )


def loss_parts(
    outputs: Tensor, wanted: WantedOutputs, *, style: bool = True, compare: Compare | None = None
) -> Parts:
    """Parts of the loss of a step's pictures, scalars: means over them.

    Args:
        outputs: (B, ANSWERS, H, W) of the network.
        wanted: the truth.
        style: whether statistics of relit pictures are compared, which takes as long as the rest.
        compare: `compared`, or its compiled form.
    """
    w = wanted
    parts, estimated, true = (compare or compared)(
        outputs, w.truth, (w.metal, w.hue, w.seen), w.base, w.points, w.camera, w.near, w.far
    )
    if style:
        parts = {**parts, "style": _style(estimated, true)}
    return parts


def total(parts: Parts, **others: float) -> Tensor:
    """Sum of the parts, weighted by WEIGHTS or, where they are named, by other weights."""
    weights = {**WEIGHTS, **others}
    return torch.stack([weights[name] * part for name, part in parts.items()]).sum()


def compared(
    outputs: Tensor,
    truth: Tensor,
    metals: tuple[Tensor, Tensor, Tensor],
    base: Tensor,
    points: Tensor,
    camera: Tensor,
    near: Tensor,
    far: Tensor,
) -> tuple[Parts, Tensor, Tensor]:
    """All parts but the style, and (B, 3, H, W) estimated and true pictures under the far light.

    Args:
        outputs: of the network; the others as in WantedOutputs, with metals = (metal, hue, seen).
    """
    answer = NetworkAnswer.from_stacked(outputs)
    estimated, true = answer.residuals, SurfaceParameters.from_stacked(truth)
    uniform = SurfaceParameters.from_stacked(base)
    metal, hue, seen = metals
    maps_estimated = _tinted(
        (uniform + estimated).reflectance(), specular_tint(answer.metal.sigmoid(), seen)
    )
    maps_true = _tinted((uniform + true).reflectance(), hue)
    # Metal's diffuse albedo is too dark for errors of its logarithm to be visible.
    albedo_estimated, albedo_true = (
        m.diffuse.add(BLACK).log() for m in (maps_estimated, maps_true)
    )
    albedo_error = (albedo_estimated - albedo_true).abs()
    specular_error = (estimated.specular - true.specular).abs()
    roughness_error = (estimated.roughness - true.roughness).abs()
    slopes_estimated, slopes_true = _slopes(estimated.height), _slopes(true.height)
    strength = slopes_true[0].square().mean((1, 2, 3)).sqrt() + _FLAT
    slope_errors = [
        (a - b).abs().mean((1, 2, 3)) for a, b in zip(slopes_estimated, slopes_true, strict=True)
    ]
    inner = (..., slice(1, -1), slice(1, -1))
    errors = ExpectedErrors(
        albedo_error.mean(1, keepdim=True)[inner],
        specular_error[inner],
        roughness_error[inner],
        (slopes_estimated[0] - slopes_true[0]).abs().mean(1, keepdim=True),
    ).stacked()
    doubt = (answer.errors.stacked()[inner] - (errors.detach() + LEAST_ERROR).log()).abs().mean()
    normal_estimated, normal_true = (normals_from_height(s.height, 1.0) for s in (estimated, true))
    thin = (..., slice(None, None, _THIN), slice(None, None, _THIN))
    at_near = FlashLight.between(points[thin], camera, near, _power(near))
    at_far = FlashLight.between(points, camera, far, _power(far))
    near_estimated, near_true = (
        at_near.onto(normal[thin]).radiance(*(m[thin] for m in maps))
        for maps, normal in ((maps_estimated, normal_estimated), (maps_true, normal_true))
    )
    far_estimated = at_far.onto(normal_estimated).radiance(*maps_estimated)
    far_true = at_far.onto(normal_true).radiance(*maps_true)
    gain = _WHITE / far_true.mean((1, 2, 3), keepdim=True)
    parts = {
        "albedo": albedo_error.mean(),
        "specular": specular_error.mean(),
        "roughness": roughness_error.mean(),
        "slope": (torch.stack(slope_errors).sum(0) / strength).mean(),
        "energy": _energies(slopes_estimated, slopes_true, albedo_estimated, albedo_true),
        "render": 0.5
        * (_log_error(near_estimated, near_true) + _log_error(far_estimated, far_true)),
        "doubt": doubt,
        "metal": F.binary_cross_entropy_with_logits(answer.metal, metal),
    }
    return parts, far_estimated * gain, far_true * gain


def _tinted(reflectance: Reflectance, hue: Tensor) -> Reflectance:
    """Reflectance with F0 multiplied by the metals' specular tint."""
    return reflectance._replace(specular=(reflectance.specular * hue).clamp_max(_MOST_F0))


def _lights(sample: Sample, rng: np.random.Generator) -> tuple[Sequence[float], Sequence[float]]:
    """Positions of a light whose mirror point lies in the picture, and of a far one."""
    height, width = sample.points.shape[-2:]
    x = float(sample.points[0, 0, int(rng.integers(width))])
    y = float(sample.points[1, int(rng.integers(height)), 0])
    up = rng.uniform(0.6, 2.5)
    there = 1.0 + up / sample.uniform.setup.distance
    polar, around = math.radians(rng.uniform(15.0, 68.0)), rng.uniform(0.0, 2.0 * math.pi)
    return (x * there, y * there, up), spherical(rng.uniform(1.3, 3.0), polar, around)


def _slopes(height: Tensor) -> list[Tensor]:
    """(B, 2, h, w) slopes of heights (B, 1, H, W) in texels, level by level of a pyramid."""
    levels = []
    for level in range(_LEVELS):
        if level:
            height = F.avg_pool2d(height, 2)
        step = 2.0 * 2**level
        across = (height[..., 1:-1, 2:] - height[..., 1:-1, :-2]) / step
        down = (height[..., 2:, 1:-1] - height[..., :-2, 1:-1]) / step
        levels.append(torch.cat([across, -down], 1))
    return levels


def _energies(
    estimated: list[Tensor], true: list[Tensor], albedo_estimated: Tensor, albedo_true: Tensor
) -> Tensor:
    """Mean absolute difference of local log band energies of slopes and albedo."""
    differences = []
    for level, (a, b) in enumerate(zip(estimated, true, strict=True)):
        cell = max(4, _CELLS >> level)
        e = (_FLAT / 2**level) ** 2
        differences.append(_strength(a, cell, e) - _strength(b, cell, e))
    bands_estimated, bands_true = _bands(albedo_estimated), _bands(albedo_true)
    for level, (a, b) in enumerate(zip(bands_estimated, bands_true, strict=True)):
        cell = max(4, _CELLS >> level)
        differences.append(0.5 * (_strength(a, cell, _PLAIN**2) - _strength(b, cell, _PLAIN**2)))
    return torch.stack([d.abs().mean() for d in differences]).mean()


def _strength(band: Tensor, cell: int, least: float) -> Tensor:
    """Log root mean square of a band (B, C, h, w) over square cells of `cell` texels."""
    squared = band.square().mean(1, keepdim=True)
    size = min(cell, *squared.shape[-2:])
    return 0.5 * (F.avg_pool2d(squared, size, stride=max(1, size // 2)) + least).log()


def _bands(picture: Tensor) -> list[Tensor]:
    """Differences between levels of a pyramid of pictures (B, C, H, W)."""
    bands = []
    for _ in range(_LEVELS - 1):
        coarse = F.avg_pool2d(picture, 2)
        back = F.interpolate(coarse, scale_factor=2.0, mode="bilinear", align_corners=False)
        bands.append(picture[..., : back.shape[-2], : back.shape[-1]] - back)
        picture = coarse
    return bands


def _log_error(estimated: Tensor, true: Tensor) -> Tensor:
    return ((estimated + DARKEST).log() - (true + DARKEST).log()).abs().mean()


def _style(estimated: Tensor, true: Tensor) -> Tensor:
    """Relative difference of Gram matrices of random filters, of pictures (B, 3, H, W)."""

    def described(picture: Tensor) -> list[Tensor]:
        toned = (picture.clamp(0.0, 1.5) + 1e-3).pow(1.0 / 2.2)
        toned = toned.contiguous(memory_format=torch.channels_last)
        return [gram(_BANK.features(level)) for level in pyramid(toned, _BANK.levels)]

    with torch.no_grad():
        sought = described(true)
    differences = []
    for a, b in zip(described(estimated), sought, strict=True):
        most = a.detach().abs().mean((1, 2)) + b.abs().mean((1, 2)) + 1e-6
        differences.append(((a - b).abs().mean((1, 2)) / most * 2.0).mean())
    return torch.stack(differences).mean()


def _power(light: Tensor) -> Tensor:
    """(B, 1, 1, 1) radiant intensity of lights (B, 3, 1, 1) that makes a white plane's middle 1."""
    return math.pi * dot(light, light) ** 1.5 / light[:, 2:]


_AHEAD = 4  # samples made before they are wanted
_WARM_UP = 200  # steps
_REPORTED = 50  # steps
_MINUTES = 2.0  # between checkpoints
_AVERAGE = 0.999  # decay of the weights' running average
_STYLED = 2  # interval, in steps, of the loss on statistics of relit pictures

SampleBatch = list[tuple[Tensor, Sample]]  # inputs and truth, of one size


@dataclass(frozen=True)
class TrainSettings:
    """Settings of one training run of the inverse network."""

    steps: int = 1_000_000
    """Total number of steps at the end of the run."""
    seconds: float = float("inf")
    """Time limit of the run."""
    rate: float = 4e-4
    """Adam's learning rate."""
    cooling: int = 0
    """Number of last steps over which the learning rate falls to 0."""
    width: int = 224
    height: int = 160
    """Texels of a picture, multiples of 32."""
    batch: int = 1
    """Pictures a step."""
    workers: int = 1
    """Processes that make samples."""
    device: str = "cpu"
    """"cpu" or "cuda"."""
    compiled: bool = False
    """Losses are compiled: minutes once, worthwhile from an hour of training."""
    maps: Path | None = None
    """Packed real materials (samples.py), whose training sets are used; or none."""
    real: float = REAL_SHARE
    """Share of photographs of real materials."""

    @property
    def schedule(self) -> RateSchedule:
        """Learning-rate schedule."""
        return RateSchedule(self.steps, _WARM_UP, self.cooling, seconds=self.seconds)


def start(config: InverseConfig, settings: TrainSettings) -> Training[Inverse]:
    """An untrained state."""
    torch.manual_seed(0)
    return Training(Inverse(config).to(settings.device), {"": settings.rate}, decay=_AVERAGE)


def train(
    folder: Path,
    settings: TrainSettings,
    config: InverseConfig = InverseConfig(),  # noqa: B008
    on_progress: Callable[[str], None] = print,
    begin: Path | None = None,
) -> Training[Inverse]:
    """Train one run, from the checkpoint in a folder if there is one.

    Checkpoint and curves are written there. A first run begins with random weights, or with the
    shipped network `begin`.
    """
    training = start(config, settings)
    if (folder / CHECKPOINT).exists():
        training.load(folder)
    elif begin:
        network, origin = read_inverse(begin)
        training.about = {"origin": origin}
        for part in (training.model, training.average):
            part.load_state_dict(network.state_dict())
    samples = _samples(training.step, settings)
    compare: Compare = torch.compile(compared, dynamic=False) if settings.compiled else compared

    def loss_of(step: int) -> tuple[Tensor, Mapping[str, Tensor]]:
        batch = next(samples)
        training.about["shown"] = training.about.get("shown", 0) + len(batch)
        return step_loss(training.model, step, batch, settings, compare)

    reporting = Reporting(_REPORTED, _MINUTES, on_progress=on_progress)
    fit(training, loss_of, settings.schedule, folder, reporting)
    samples.close()
    return training


def step_loss(
    model: Inverse,
    step: int,
    batch: SampleBatch,
    settings: TrainSettings,
    compare: Compare = compared,
) -> tuple[Tensor, Mapping[str, Tensor]]:
    """Loss of a step, and its parts; `compare` is `compared`, or its compiled form."""
    inputs = torch.stack([x for x, _ in batch]).to(settings.device)
    rng = np.random.default_rng([step, 0, 5])
    truth = wanted([sample for _, sample in batch], rng, settings.device)
    outputs = model(inputs.contiguous(memory_format=torch.channels_last))
    # Statistics take as long as the rest: every _STYLED steps, with as many times their weight.
    parts = loss_parts(outputs, truth, style=step % _STYLED == 0, compare=compare)
    return total(parts, style=WEIGHTS["style"] * _STYLED), parts


def _samples(step: int, settings: TrainSettings) -> Generator[SampleBatch, None, None]:
    """Batches from a step on, prefetched by worker processes."""
    if settings.workers == 0:
        while True:
            yield [_made((step * settings.batch + i, settings)) for i in range(settings.batch)]
            step += 1
    context = multiprocessing.get_context("spawn")
    with context.Pool(settings.workers, initializer=compute_alone) as pool:
        waiting: list[AsyncResult[tuple[Tensor, Sample]]] = []
        number = step * settings.batch
        while True:
            while len(waiting) < _AHEAD * settings.batch:
                waiting.append(pool.apply_async(_made, ((number, settings),)))
                number += 1
            yield [waiting.pop(0).get() for _ in range(settings.batch)]


def _made(asked: tuple[int, TrainSettings]) -> tuple[Tensor, Sample]:
    number, settings = asked
    sets = training_sets(settings.maps) if settings.maps else ()
    sample = draw_sample(number, settings.width, settings.height, sets=sets, real=settings.real)
    return sample.inputs, sample


def read_network(path: Path) -> Inverse:
    """The network of a file, or the running average of a training's folder.

    Raises:
        MatcapError: it is neither.
    """
    return _trained(path).average if path.is_dir() else read_inverse(path)[0]


def ship(folder: Path, out: Path) -> dict[str, Any]:
    """Write a training's running average as captures read it; returns its card.

    Raises:
        MatcapError: the folder holds no training.
    """
    training = _trained(folder)
    origin = training.about.get("origin", {})
    seen = origin.get("photographs_seen", origin.get("steps", 0))
    card: dict[str, Any] = {
        "steps": training.step,
        "photographs_seen": seen + training.about.get("shown", 0),
        "photographs": "of real map sets and simulated materials (matcap_lab/inverse/samples.py)",
        "held_out": [
            *HELD_OUT,
            *(f"random materials of {name}" for name in HELD_OUT_PATTERNS),
            "real sets by name (matcap_lab/inverse/samples.py, is_held_out)",
        ],
    }
    save_inverse(training.average, out, card)
    return card


def _trained(folder: Path) -> Training[Inverse]:
    if not (folder / CHECKPOINT).is_file():
        raise MatcapError.at(
            folder,
            "there is no training in this folder",
            "give the folder that `matcap-lab inverse train` was given",
        )
    training = start(InverseConfig(), TrainSettings())
    training.load(folder)
    return training


def save_inverse(network: Inverse, path: Path, card: Mapping[str, Any]) -> None:
    """Write weights in half precision and a card, how they were trained, whole or not at all.

    Raises:
        MatcapError: the folder cannot be written.
    """
    tensors = {name: value.half() for name, value in network.state_dict().items()}
    about = {
        "format": FORMAT,
        "version": VERSION,
        "widths": network.config.widths,
        "context": network.config.context,
        "card": dict(card),
    }
    write_tensors(path, tensors, {"matcap": json.dumps(about)})
