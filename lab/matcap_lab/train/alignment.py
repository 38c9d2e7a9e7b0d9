"""Trains the alignment branch on simulated photographs, whose tilt is known.

Photographs follow a random model of phones: a flash mostly above the lens, its falloff around its
own axis, the lens's vignetting around the picture's centre, automatic exposure, clipping, and, of
developed pictures, a tone curve, a shoulder and slow gradients of brightness. At times EXIF is
missing, and the field of view is then the assumed one. A material is rendered several times;
exposure and development are drawn anew in every step.

The loss is the Gaussian negative log-likelihood of both angles under the predicted mean and
standard deviation [nix1994; kendall2017]. Tilts are uniform, so that the
prediction is a likelihood; a capture multiplies it by the distribution of real tilts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.flash.alignment import (
    UNKNOWN_FOV,
    WIDTH,
    Alignment,
    Fusion,
    PictureTilt,
    conditions,
    evidence,
    log_colour,
    picture_coordinates,
    tilt_measurement,
)
from matcap.flash.coarse.fit import fit_coarse
from matcap.flash.geometry import FlashSetup
from matcap.flash.light import CORNER_SQUARED
from matcap.photo.exif import phone_fov
from matcap.photo.photo import Photo
from matcap_lab.simulate.kinds import KINDS, RandomKind, kind_of
from matcap_lab.simulate.photograph import (
    PhoneCamera,
    contrast,
    drift,
    exposure,
    noisy,
    random_crop,
    shoulder,
    take,
)
from matcap_lab.simulate.varied import RandomMaterial, random_material
from matcap_lab.train.corpus import decode, encode, srgb_bytes
from matcap_lab.train.trainer import RateSchedule, Reporting, Training, fit, mixed

# Kinds and patterns excluded from training: the branch is evaluated on them.
HELD_OUT_KINDS = ("gravel", "weave", "planks", "hammered", "plates")
EVALUATED = 1024  # pixels across a photograph that the branch is measured by
UNSEEN = 1_000_000  # seeds from here on show what is held out
SHOTS = 8  # of a material: making it takes longer than a shot
_MOST_TILT = math.radians(15.0)
_KIND_SHARE = 0.6
_PIECE = 1.3  # width of a piece over the picture's width, which is its height
_JPEGS, _WITHOUT_EXIF = 0.65, 0.4  # shares: of photographs, and of those of developed ones
_QUALITY = 92
_RATE, _RATE_ON = 1.5e-3, 8e-4  # of training from random weights, and on from trained ones


@dataclass(frozen=True)
class Tilted:
    """Simulated photographs before exposure, and their true geometry."""

    radiance: Tensor
    """(N, 3, h, WIDTH) float16, its median 1, nothing clipped."""
    fov: Tensor
    """(N,) degrees."""
    offset: Tensor
    """(N, 2) of the flash from the lens, plane units."""
    tilt: Tensor
    """(N, 2) radians."""

    def at(self, chosen: Tensor) -> Tilted:
        """The photographs of some indices."""
        return Tilted(*(values[chosen] for values in vars(self).values()))


@dataclass(frozen=True)
class Developed:
    """Photographs after exposure and development."""

    linear: Tensor
    """(N, 3, h, w) in [0, 1]."""
    fov: Tensor
    """(N,) degrees, as the file says or as assumed."""
    known: Tensor
    """(N,) bool, whether the file says it."""
    radiometric: Tensor
    """(N,) bool, whether they are RAW."""

    def shown(self) -> tuple[Tensor, Tensor]:
        """The branch's inputs: pictures and conditions."""
        height, width = self.linear.shape[-2:]
        place = picture_coordinates(width, height)
        pictures = [torch.cat([log_colour(linear), place]) for linear in self.linear]
        return torch.stack(pictures), conditions(self.fov, self.known, self.radiometric)


def draw_setup(rng: np.random.Generator, fov: float) -> FlashSetup:
    """A phone 8 to 30 cm above a material, its flash 1 to 4 cm from the lens, mostly above it."""
    above = rng.random() < 0.6
    reach = math.exp(rng.normal(math.log(0.12), 0.6))
    # Offsets relative to the picture are large of close phones; most real ones have 0.3.
    reach = rng.uniform(0.0, 0.45) if above else float(np.clip(reach, 0.01, 0.35))
    angle = math.pi / 2.0 + rng.normal(0.0, 0.2) if above else rng.uniform(0.0, 2.0 * math.pi)
    tilt = rng.uniform(-_MOST_TILT, _MOST_TILT, 2)
    return FlashSetup(
        fov=fov,
        offset=(reach * math.cos(angle), reach * math.sin(angle), 0.0),
        tilt=(float(tilt[0]), float(tilt[1])),
    )


def material_of(seed: int) -> RandomMaterial | RandomKind:
    """The material of a seed; those from UNSEEN on are of held-out kinds and patterns."""
    rng = np.random.default_rng([20261126, seed])
    held_out = seed >= UNSEEN
    if rng.random() < _KIND_SHARE:
        names = [name for name in KINDS if (name in HELD_OUT_KINDS) == held_out]
        return kind_of(names[rng.integers(len(names))], int(rng.integers(2**32)))
    while True:
        material = random_material(rng)
        if material.is_held_out == held_out:
            return material


def take_tilted(seed: int, width: int, shots: int = SHOTS) -> Tilted:
    """A material of a seed, photographed `width` pixels across from several tilts."""
    rng = np.random.default_rng([20261127, seed])
    material = material_of(seed)
    windows = []
    # The shots are of parts of one piece.
    pieces = cache(lambda texel: material.realise(round(_PIECE * width), width, seed, texel))
    for _ in range(shots):
        camera = PhoneCamera(
            width=width,
            height=width * 3 // 4,
            focal_length=int(rng.integers(20, 44)),
            supersampling=1,
            blur=float(rng.uniform(0.4, 1.0)),
        )
        setup = draw_setup(rng, camera.fov)
        realise = partial(_cut, pieces, rng)
        linear = torch.from_numpy(take(realise, camera, setup).linear).permute(2, 0, 1)
        linear = linear / linear.mean(0).median().clamp_min(1e-6)
        windows.append((linear.clamp(0.0, 6e4).half(), camera.fov, setup.offset[:2], setup.tilt))
    radiance, fov, offset, tilt = zip(*windows, strict=True)
    return Tilted(
        torch.stack(radiance), torch.tensor(fov), torch.tensor(offset), torch.tensor(tilt)
    )


def _cut(
    pieces: Callable[[float], MapSet],
    rng: np.random.Generator,
    width: int,
    height: int,
    texel: float,
) -> MapSet:
    """A part of a piece, anywhere in it; mirrored where the piece is too small."""
    piece = pieces(texel)
    across, down = piece.size
    if width > across or height > down:
        pad = (0, max(0, width - across), 0, max(0, height - down))
        piece = piece.map(lambda m: F.pad(m[None], pad, mode="reflect")[0])
    return random_crop(piece, width, height, rng)


def tilted_photographs(seeds: Sequence[int], width: int = 384) -> Tilted:
    """Photographs of one material for each seed, rendered `width` pixels wide and downsampled."""
    parts = [take_tilted(seed, width) for seed in seeds]
    small = [F.adaptive_avg_pool2d(p.radiance.float(), (WIDTH * 3 // 4, WIDTH)) for p in parts]
    return Tilted(
        torch.cat(small).half(),
        torch.cat([p.fov for p in parts]),
        torch.cat([p.offset for p in parts]),
        torch.cat([p.tilt for p in parts]),
    )


def mirror(taken: Tilted) -> Tilted:
    """The photographs mirrored left to right, geometry included."""
    return Tilted(
        taken.radiance.flip(-1),
        taken.fov,
        taken.offset * torch.tensor([-1.0, 1.0]),
        taken.tilt * torch.tensor([1.0, -1.0]),
    )


def develop(taken: Tilted, rng: np.random.Generator, radiometric: bool | None = None) -> Developed:
    """Expose photographs, and develop those that are not RAW.

    All are RAW, or none, by `radiometric`; None draws it for each.
    """
    pictures, fov, known, raw = [], [], [], []
    for radiance, view, offset in zip(taken.radiance, taken.fov, taken.offset, strict=True):
        is_raw = bool(rng.random() >= _JPEGS) if radiometric is None else radiometric
        linear = _exposed(radiance.float(), offset, is_raw, rng)
        blind = not is_raw and rng.random() < _WITHOUT_EXIF
        pictures.append(linear)
        fov.append(UNKNOWN_FOV if blind else float(view))
        known.append(not blind)
        raw.append(is_raw)
    return Developed(
        torch.stack(pictures), torch.tensor(fov), torch.tensor(known), torch.tensor(raw)
    )


def _exposed(
    radiance: Tensor, offset: Tensor, radiometric: bool, rng: np.random.Generator
) -> Tensor:
    """(3, h, w) in [0, 1] after vignetting, exposure, tone curve, noise and clipping."""
    height, width = radiance.shape[-2:]
    place = picture_coordinates(width, height)
    lens = place.square().sum(0) / CORNER_SQUARED
    cone = (place - offset[:, None, None]).square().sum(0) / CORNER_SQUARED
    strength = 0.5 * float(rng.random() < 0.5) if radiometric else 1.0
    a, b, c, d = (strength * rng.uniform(0.0, most) for most in (0.4, 0.4, 0.7, 0.9))
    if radiometric:
        a = b = 0.0  # a lens profile undoes it; the flash's cone stays
    falloff = (a + b * lens) * lens + (c + d * cone) * cone
    # The LED's axis is not the lens's: on 6 of 10 measured phones it points above it.
    ramp = rng.normal(0.0, 0.1, 2)  # gradient of log brightness, per plane unit
    if not radiometric:
        ramp[1] += rng.uniform(0.0, 1.0) if rng.random() < 0.6 else rng.normal(0.0, 0.2)
    falloff = falloff - ramp[0] * place[0] - ramp[1] * place[1]
    linear = radiance * (-falloff).exp()
    linear = linear * exposure(linear, rng)
    if not radiometric:
        linear = contrast(linear, rng.uniform(0.75, 1.3))
        if rng.random() < 0.5:
            linear = linear * drift(height, width, rng, 0.03, 0.01)
        linear = shoulder(linear, rng.uniform(0.0, 0.8))
    return noisy(linear, rng.uniform(0.0, 1.0) ** 2 * width / 1024.0, rng)


def tilted_photo(
    seed: int, width: int = 512, *, radiometric: bool = False
) -> tuple[Photo, tuple[float, float]]:
    """A photograph of a material, tilted up to 15 degrees, and its tilt in radians.

    One that is developed goes through a JPEG.
    """
    taken = take_tilted(seed, width, 1)
    photo = written(taken, np.random.default_rng([20261128, seed]), f"tilted_{seed}", radiometric)
    tilt_x, tilt_y = taken.tilt[0].tolist()
    return photo, (tilt_x, tilt_y)


def written(taken: Tilted, rng: np.random.Generator, name: str, radiometric: bool) -> Photo:
    """The photograph of one shot, developed; a JPEG is encoded and read again."""
    done = develop(taken, rng, radiometric)
    height, width = done.linear.shape[-2:]
    pixels = np.ascontiguousarray(done.linear[0].permute(1, 2, 0).numpy())
    if not radiometric:
        photo = decode(encode(srgb_bytes(pixels), _QUALITY), name, float(done.fov[0]))
        if bool(done.known[0]):
            return replace(photo, fov_source="exif")
        return replace(photo, fov=phone_fov(width, height), fov_source="assumed")
    return Photo(
        pixels=pixels,
        clipped=np.asarray((pixels >= 1.0).any(axis=-1)),
        fov=float(done.fov[0]),
        fov_source="exif",
        radiometric=True,
        name=name,
        original_size=(width, height),
    )


def train_alignment(
    pool: Tilted,
    steps: int,
    *,
    batch: int = 24,
    start: PictureTilt | None = None,
    on_progress: Callable[[str], None] = lambda line: None,
) -> PictureTilt:
    """Train: AdamW on the negative log-likelihood, the rate falling from the first step on.

    A step takes `batch` photographs of the pool. `start` is trained on, in place; None for random
    weights. `on_progress` gets a line every 50 steps.
    """
    torch.manual_seed(0)
    network = (start or PictureTilt()).requires_grad_(True).train()
    network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    rate = _RATE_ON if start else _RATE
    training = Training(network, {"": rate}, decay=0.0, weight_decay=0.02)
    rng = np.random.default_rng(0)

    def loss_of(_step: int) -> tuple[Tensor, Mapping[str, Tensor]]:
        taken = pool.at(torch.from_numpy(rng.integers(0, len(pool.fov), batch)))
        if rng.random() < 0.5:
            taken = mirror(taken)
        pictures, known = develop(_cropped(taken, rng), rng).shown()
        order = torch.from_numpy(np.concatenate([rng.permutation(3), [3, 4]]))
        with mixed("cpu"):
            estimate, log_std = training.model(pictures[:, order], known)
        error = torch.rad2deg((estimate - taken.tilt).abs().mean())
        return likelihood_loss(estimate, log_std, taken.tilt), {"degrees": error}

    reporting = Reporting(50, math.inf, on_progress=on_progress)
    fit(training, loss_of, RateSchedule(steps, 30, steps), None, reporting)
    return training.model.eval()


def likelihood_loss(mean: Tensor, log_std: Tensor, tilt: Tensor) -> Tensor:
    """Gaussian negative log-likelihood of angles, but for a constant; of (B, 2) each.

    Weighted by the standard deviation to the power 1/2 (beta-NLL [seitzer2022]): without it,
    hard samples get large deviations and hence small gradients before they are learnt.
    """
    nll = 0.5 * ((tilt - mean) / log_std.exp()).square() + log_std
    return (nll * (0.5 * log_std).exp().detach()).mean()


def _cropped(taken: Tilted, rng: np.random.Generator) -> Tilted:
    """Photographs of 4 : 3, or with rows cropped to 3 : 2 or 16 : 9."""
    rows = WIDTH * 3 // 4
    kept = int(rng.choice([rows, WIDTH * 2 // 3, WIDTH * 9 // 16], p=[0.7, 0.15, 0.15]))
    if taken.radiance.shape[-2] < kept:
        return taken
    top = (taken.radiance.shape[-2] - kept) // 2
    return replace(taken, radiance=taken.radiance[..., top : top + kept, :])


def report_alignment(branch: Alignment, count: int = 120) -> str:
    """A Markdown table of the branch's errors on materials of held-out kinds, JPEG and RAW.

    Means of absolute errors: the branch's, and of the tilt that a capture uses, the coarse fit's
    that has the branch's angles.
    """
    lines = [
        "| photographs | mean absolute error | 95th percentile | mean, about x and y "
        "| within one standard deviation | used |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for name, radiometric in (("JPEG", False), ("RAW", True)):
        errors, scores, used = [], [], []
        for seed in range(UNSEEN, UNSEEN + count):
            photo, true = tilted_photo(seed, EVALUATED, radiometric=radiometric)
            measured = tilt_measurement(photo, branch)
            coarse = fit_coarse(photo, tilt_prior=measured)
            tilt = torch.tensor(true)
            errors.append(torch.tensor(measured.mean) - tilt)
            scores.append(errors[-1] / torch.tensor(measured.std))
            used.append(torch.tensor(coarse.setup.tilt) - tilt)
        degrees = torch.rad2deg(torch.stack(errors))
        size, (x, y) = degrees.abs(), degrees.mean(0).tolist()
        within = float((torch.stack(scores).abs() < 1.0).float().mean())
        off = float(torch.rad2deg(torch.stack(used)).abs().mean())
        lines.append(
            f"| {count} {name} | {float(size.mean()):.2f} | {float(size.quantile(0.95)):.2f} "
            f"| {x:+.2f}, {y:+.2f} | {within:.0%} | {off:.2f} |"
        )
    return "\n".join(lines)


# Trains the alignment branch's fusion: the weights of its picture and of convergence.
#
# Photographs are as wide as a capture reads them, as convergence needs fine texture; each is also
# read at half its size. Each pair of angles is a sample, mirrored at random.

MATERIALS = 290  # of a pool
_SHOTS = 4  # of a material
_STEPS, _BATCH, _FUSION_RATE = 3000, 128, 3e-3
_JITTER = 0.05  # standard deviation of noise on the inputs' logarithms


def train_branch(
    materials: int,
    steps: int,
    *,
    fused: int = MATERIALS,
    start: Alignment | None = None,
    on_progress: Callable[[str], None] = lambda line: None,
) -> Alignment:
    """The whole branch: its network for pictures, by `steps` steps on `materials`, then the fusion.

    `fused` is the number of the fusion's materials; `start` is trained on, in place.
    """
    branch = Alignment() if start is None else start
    begun = None if start is None else branch.picture
    pool = tilted_photographs(range(materials))
    branch.picture = train_alignment(pool, steps, start=begun, on_progress=on_progress)
    branch.requires_grad_(False)
    train_fusion(branch.fusion, *samples(branch.picture, range(fused)), on_progress=on_progress)
    return branch


def samples(network: PictureTilt, seeds: Sequence[int]) -> tuple[tuple[Tensor, ...], Tensor]:
    """The fusion's four inputs for photographs of the materials of seeds, and true tilts (N, 2)."""
    inputs, tilts = [], []
    for seed in seeds:
        taken = take_tilted(seed, EVALUATED, _SHOTS)
        for shot in range(_SHOTS):
            one = taken.at(torch.tensor([shot]))
            rng = np.random.default_rng([77, seed, shot])
            photo = written(one, rng, f"{seed}_{shot}", radiometric=bool(shot % 2))
            for read in map(evidence, (photo, halved(photo))):
                conditions = read.conditions[None]
                with torch.no_grad():
                    mean, log_std = network(read.picture[None], conditions)
                inputs.append((mean, log_std, conditions, read.slopes[None]))
                tilts.append(one.tilt[0])
    return tuple(torch.cat(each) for each in zip(*inputs, strict=True)), torch.stack(tilts)


def halved(photo: Photo) -> Photo:
    """The photograph with half its pixels each way."""
    small = cv2.resize(photo.pixels, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return replace(photo, pixels=np.asarray(small, np.float32), clipped=photo.clipped[::2, ::2])


def train_fusion(
    fusion: Fusion,
    inputs: tuple[Tensor, ...],
    tilts: Tensor,
    *,
    on_progress: Callable[[str], None] = lambda line: None,
) -> None:
    """Train in place: AdamW on the negative log-likelihood of the tilts (N, 2).

    Inputs are those of samples(). `on_progress` gets a line every 500 steps.
    """
    torch.manual_seed(0)
    training = Training(
        fusion.requires_grad_(True).train(), {"": _FUSION_RATE}, decay=0.0, weight_decay=0.05
    )

    def loss_of(_step: int) -> tuple[Tensor, Mapping[str, Tensor]]:
        chosen = torch.randint(0, len(tilts), (_BATCH,))
        sign = torch.ones(_BATCH, 2)
        sign[:, 1] -= 2.0 * (torch.rand(_BATCH) < 0.5)
        given, given_std, known, slopes = (each[chosen] for each in inputs)
        # A mirrored picture turns tilt_y's sign, and the slope's along x.
        across = torch.cat([sign.flip(-1), torch.ones(_BATCH, 2)], dim=1)[:, None]
        noise = (_JITTER * torch.randn(slopes.shape)).exp()
        mean, std = training.model(given * sign, given_std, known, slopes * across * noise)
        true = tilts[chosen] * sign
        error = torch.rad2deg((mean - true).abs().mean())
        return likelihood_loss(mean, std, true), {"degrees": error}

    reporting = Reporting(500, float("inf"), on_progress=on_progress)
    fit(training, loss_of, RateSchedule(_STEPS, 30, _STEPS), None, reporting)
    fusion.requires_grad_(False).eval()
