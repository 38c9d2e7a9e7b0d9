"""A training step of the prior: its state, windows of photographs, and the loss.

A flip or a quarter turn is applied to pixels, plane points, vignetting, camera, flash and waves
alike, so the geometry stays consistent. Colour channels are permuted and scaled a little (white
balance), together with the base.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from matcap.brdf.maps import MapSet, energy_between, relief_difference, shown_energy
from matcap.errors import UsageError
from matcap.field.plane import Rectangle
from matcap.flash.alignment import picture
from matcap.flash.geometry import camera_in_plane, plane_points
from matcap.flash.light import FlashLight, shade, vignette
from matcap.flash.rectify import read_plane
from matcap.space.decoder import DEPTH, OUTPUTS, Decoder, DecoderConfig, maps_from_raw
from matcap.space.encoder import Encoder, EncoderConfig, numbers, texture
from matcap.space.prior.store import Base, Prior, base_of
from matcap.space.random_field import WAVE_CHANNELS, Patch, RandomField, noise_field, wave_field
from matcap.statistics.compare import Descriptor, Encoding, FilterBank, Weights, describe, distance
from matcap.statistics.lattice import Wave
from matcap_lab.measures.evaluator import spherical
from matcap_lab.train.corpus import WAVE_DETAIL, Entry
from matcap_lab.train.trainer import Training, mixed

_START = (1.0, 1.0, 1.0, 0.33, 0.33, 0.33)  # deviations of an untrained head's outputs


@dataclass(frozen=True)
class TrainConfig:
    """Settings of training a prior; a TOML file has the same names (cli/prior.py)."""

    steps: int = 6000
    """Number of steps; the learning rate falls to nothing over the last quarter."""
    materials: int = 4
    """Photographs of different materials in a step."""
    places: int = 2
    """Windows of each photograph."""
    window: int = 160
    """Texels a side, MARGIN short of a multiple of 16 on either side."""
    real_share: float = 0.65
    """Share of real photographs."""
    coarse_share: float = 0.15
    """Share of photographs used at half the resolution."""
    rate: float = 2e-3
    encoder_rate: float = 5e-4
    """Learning rates of AdamW, of decoder and encoder."""
    weight_decay: float = 1e-5
    """Weight decay of AdamW."""
    kl: float = 0.03
    """Weight of the KL term, per dimension of the code."""
    kl_warmup: int = 1000
    """Steps until the KL term counts in full."""
    slope: float = 0.02
    """Weight of the mean squared slope, and of slopes too steep or too fine (step.py)."""
    relit: float = 0.0
    """Weight of the second teacher (step.py); 0 leaves it out."""
    average: float = 0.998
    """Decay of the running mean of the weights, which is what is shipped."""
    seed: int = 1
    """Seed of all random numbers."""
    checkpoint_minutes: float = 4.0
    """Minutes between checkpoints."""
    report_every: int = 250
    """Steps between reports on the held-out materials."""
    encoder: EncoderConfig = EncoderConfig()
    decoder: DecoderConfig = DecoderConfig()
    """Shapes of encoder and decoder."""


def start_head(decoder: Decoder) -> None:
    """Initialise an untrained head to output zero mean and the deviations _START."""
    with torch.no_grad():
        affine = decoder.head.adain.affine
        affine.weight.mul_(0.2)
        affine.bias.copy_(torch.cat([torch.zeros(OUTPUTS), torch.tensor(_START)]))


class Model(nn.Module):
    """Encoder and decoder."""

    def __init__(self, encoder: EncoderConfig, decoder: DecoderConfig) -> None:
        super().__init__()
        self.encoder = Encoder(encoder)
        self.decoder = Decoder(decoder)
        start_head(self.decoder)


def start(config: TrainConfig, device: str) -> Training[Model]:
    """An untrained state."""
    torch.manual_seed(config.seed)
    model = Model(config.encoder, config.decoder)
    model.to(device=device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    rates = {"encoder.": config.encoder_rate, "decoder.": config.rate}
    return Training(model, rates, decay=config.average, weight_decay=config.weight_decay)


def start_from(prior: Prior, config: TrainConfig, device: str) -> Training[Model]:
    """A state with a prior's networks and a new optimiser.

    Raises:
        UsageError: its networks are of other shapes than the configuration's.
    """
    state = start(config, device)
    for name, network, shape in (
        ("encoder", prior.encoder, config.encoder),
        ("decoder", prior.decoder, config.decoder),
    ):
        if network.config != shape:
            raise UsageError.at(
                "--start",
                f"the prior's {name} is of another shape than [{name}] of the settings",
                "give the settings it was trained with",
            )
        for model in (state.model, state.average):
            getattr(model, name).load_state_dict(network.state_dict())
    return state


# Windows of photographs.

_MOST_GAIN = 1.15  # of one colour over another
_LEAST_SEEN = 0.5  # of a window that must be valid


@dataclass(frozen=True)
class Turn:
    """One of the square's eight symmetries: mirrored along x or not, then quarter turns."""

    mirrored: bool = False
    quarters: int = 0

    def image(self, image: Tensor) -> Tensor:
        """(..., H, W) moved."""
        image = image.flip(-1) if self.mirrored else image
        return torch.rot90(image, self.quarters, (-2, -1))

    def vector(self, vector: Tensor) -> Tensor:
        """(N, ...) vectors whose first two parts are x (right) and y (up), moved alike."""
        x, y = vector[0], vector[1]
        x = -x if self.mirrored else x
        for _ in range(self.quarters % 4):
            x, y = -y, x
        return torch.cat([torch.stack([x, y]), vector[2:]])

    def wave(self, wave: Wave) -> Wave:
        """A wave, whose y is counted downwards, moved alike."""
        x, y = self.vector(torch.tensor([wave.fx, -wave.fy], dtype=torch.float64)).tolist()
        return Wave(x, -y)


@dataclass(frozen=True)
class PreparedPhotograph:
    """A photograph ready to be cut: everything that does not change from step to step."""

    linear: Tensor
    """(3, H, W) float16, rectified at WAVE_DETAIL texels across."""
    valid: Tensor
    """(H, W) bool."""
    picture: Tensor
    """(5, h, w) what the encoder sees."""
    encoding: Encoding
    """Encoding of the photograph."""
    entry: Entry
    """Its entry in the pack."""
    truth: MapSet | None = None
    """Maps of the same material where it was simulated, or None."""


def prepare(entry: Entry, encoder_width: int, truth: MapSet | None = None) -> PreparedPhotograph:
    """Decode and rectify a photograph of the pack; keep the maps of its material, if known."""
    photo = entry.photo()
    plane = read_plane(photo, entry.coarse.setup, WAVE_DETAIL)
    shown = picture(photo.pixels, encoder_width)
    return PreparedPhotograph(
        plane.linear.half(), plane.valid, shown, plane.encoding, entry,
        None if truth is None else truth.map(Tensor.float),
    )  # fmt: skip


@dataclass(frozen=True)
class TrainingSample:
    """One material of a batch."""

    picture: Tensor
    """(5, h, w) picture for the encoder."""
    numbers: Tensor
    """(NUMBERS,) for the encoder."""
    base: Base
    """Reflectance to which the decoder's outputs are relative."""
    waves: tuple[Wave, ...]
    """Frequencies of the material's lattice, in the windows' texels."""
    linear: Tensor
    """(K, 3, S, S) windows of the photograph."""
    points: Tensor
    """(K, 3, S, S) their plane points."""
    shading: Tensor
    """(K, 1, S, S) vignetting."""
    camera: Tensor
    light: Tensor
    intensity: Tensor
    """(3,) each, plane frame."""
    encoding: Encoding
    """Encoding of the photograph, its colours permuted like the windows'."""
    texel_size: float
    """A texel's side, plane units."""
    truth: MapSet | None = None
    """(1, C, S, S) maps of another piece of the same material, or None."""

    def to(self, device: torch.device | str) -> TrainingSample:
        """The same sample on a device."""
        tensors: dict[str, Any] = {
            name: value.to(device)
            for name, value in vars(self).items()
            if isinstance(value, Tensor)
        }
        return replace(
            self,
            base=Base(self.base.mean.to(device), self.base.deviation.to(device)),
            truth=None if self.truth is None else self.truth.map(lambda m: m.to(device)),
            **tensors,
        )

    def render(self, maps: MapSet) -> Tensor:
        """(K, 3, S, S) the maps lit and seen as in each of the windows."""
        shaded = shade(maps, self.points, self.camera, self.light, self.intensity)
        return shaded * self.shading


def cut(
    source: PreparedPhotograph,
    size: int,
    places: int,
    coarser: int,
    turn: Turn,
    rng: np.random.Generator,
    *,
    augment: bool = True,
) -> TrainingSample:
    """Cut windows of `size` texels, each `coarser` (1 or 2) of the source's, and turn them.

    With `augment` their colours are also permuted and scaled.
    """
    setup = source.entry.coarse.setup
    height, width = source.linear.shape[-2:]
    span = size * coarser
    crops, points, shading = [], [], []
    for _ in range(places):
        x, y = _place(source.valid, span, rng)
        crop = source.linear[:, y : y + span, x : x + span].float()
        crops.append(F.avg_pool2d(crop, coarser) if coarser > 1 else crop)
        place = plane_points(
            x // coarser, y // coarser, size, size, (width // coarser, height // coarser),
            dtype=torch.float32,
        )  # fmt: skip
        points.append(turn.image(turn.vector(place)))
        shading.append(turn.image(vignette(place, setup)[1:2]))
    order, gain = torch.arange(3), torch.ones(3)
    if augment:
        order = torch.from_numpy(rng.permutation(3))
        gain = torch.from_numpy(rng.uniform(1.0, _MOST_GAIN, 3)).float()
    hue = torch.log(gain) - torch.log(gain).mean()
    base = base_of(source.entry.coarse, source.entry.contrast)
    inputs = numbers(source.entry.coarse, source.entry.contrast, WAVE_DETAIL // coarser)
    camera, light = camera_in_plane(setup)
    shown = torch.cat(
        [source.picture[:3][order] + hue[:, None, None], turn.vector(source.picture[3:])]
    )
    colours = torch.cat([order, torch.arange(3, 6)])
    mean = base.mean[colours].clone()
    mean[:3] += torch.log(gain)
    inputs[:3], inputs[5:8] = inputs[:3][order] + torch.log(gain), inputs[5:8][order]
    inputs[9:11], inputs[11:13] = _turned_numbers(inputs, turn)
    return TrainingSample(
        picture=turn.image(shown),
        numbers=inputs,
        base=Base(mean, base.deviation[colours]),
        waves=tuple(turn.wave(Wave(w.fx * coarser, w.fy * coarser)) for w in source.entry.waves),
        linear=turn.image(torch.stack(crops))[:, order] * gain[:, None, None],
        points=torch.stack(points),
        shading=torch.stack(shading),
        camera=turn.vector(camera).float(),
        light=turn.vector(light).float(),
        intensity=torch.tensor(setup.intensity),
        encoding=Encoding(source.encoding.median, source.encoding.matrix[:, order]),
        texel_size=2.0 * coarser / width,
        truth=_true_window(source.truth, size, coarser, turn, rng, order, gain),
    )


def _true_window(
    truth: MapSet | None,
    size: int,
    coarser: int,
    turn: Turn,
    rng: np.random.Generator,
    order: Tensor,
    gain: Tensor,
) -> MapSet | None:
    """A window of true maps, with the turn and colours of the photograph's windows."""
    if truth is None:
        return None
    span = size * coarser
    x, y = (int(rng.integers(0, side - span + 1)) for side in truth.size)
    maps = truth.stacked()[None, :, y : y + span, x : x + span]
    maps = turn.image(F.avg_pool2d(maps, coarser) if coarser > 1 else maps)
    diffuse = (maps[:, order] * gain[:, None, None]).clamp_max(1.0)
    stacked = torch.cat([diffuse, maps[:, 3:]], dim=1)
    return MapSet.from_stacked(stacked, truth.texel_size * coarser)


def _turned_numbers(inputs: Tensor, turn: Turn) -> tuple[Tensor, Tensor]:
    """Offset and tilt among the encoder's numbers, moved.

    Tilts are rotations: about x by tilt_x, about y by tilt_y. To first order the plane's normal
    leans by (tilt_y, -tilt_x), and that vector moves like any other.
    """
    leaning = turn.vector(torch.stack([inputs[12], -inputs[11]]))
    return turn.vector(inputs[9:11]), torch.stack([-leaning[1], leaning[0]])


def _place(valid: Tensor, span: int, rng: np.random.Generator) -> tuple[int, int]:
    """Random even position of a window that is mostly valid, or the last of ten tries."""
    height, width = valid.shape
    x = y = 0
    for _ in range(10):
        x = 2 * int(rng.integers(0, (width - span) // 2 + 1))
        y = 2 * int(rng.integers(0, (height - span) // 2 + 1))
        if float(valid[y : y + span : 4, x : x + span : 4].float().mean()) >= _LEAST_SEEN:
            break
    return x, y


# One training step: loss of decoded windows against windows of photographs.

MARGIN = 16  # texels cut off each side of what is decoded: its border is not valid

_RELIEF = 0.25  # weight of relief_distance, relative to the style distance of relit maps
_STEEP, _COMB = 15.0, 25.0  # weights of penalties, relative to the mean squared slope
_MOST_SLOPE = 1.0  # slope at a texel above which it is penalised as too steep


def step_loss(
    model: Model,
    step: int,
    samples: Sequence[TrainingSample],
    config: TrainConfig,
    bank: FilterBank,
) -> tuple[Tensor, dict[str, Tensor]]:
    """Loss of a step on the device of its samples, and its parts."""
    pictures = torch.stack([s.picture for s in samples])
    numbers = torch.stack([s.numbers for s in samples])
    wanted = targets(samples, bank)
    statistics = torch.stack([texture(target) for target in wanted])
    with mixed(pictures.device):
        mean, log_variance = model.encoder(pictures, numbers, statistics)
    noise_seed = config.seed * 1_000_003 + step
    generator = torch.Generator().manual_seed(noise_seed)
    drawn = torch.randn(mean.shape, generator=generator).to(mean.device)
    code = mean + torch.exp(0.5 * log_variance) * drawn
    maps = decode_windows(model.decoder, code, samples, noise_seed)
    losses, slopes = compare(maps, samples, wanted, bank)
    kl = 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).mean()
    warm = min(1.0, step / max(1, config.kl_warmup))
    # The logarithm keeps a plain material, whose small statistics have large relative errors, from
    # dominating the others.
    style = torch.log1p(losses).mean()
    parts = {"style": style, "kl": kl, "slope": slopes.mean()}
    loss = style + config.kl * warm * kl + config.slope * slopes.mean()
    relit = taught(maps, samples, noise_seed, bank) if config.relit else None
    if relit is not None:
        loss = loss + config.relit * relit.sum() / len(samples)
        parts["relit"] = relit.mean()
    return loss, parts


def targets(samples: Sequence[TrainingSample], bank: FilterBank) -> list[Descriptor]:
    """Texture descriptors of each sample's windows."""
    with torch.no_grad(), mixed(samples[0].linear.device):
        return [describe(s.linear, s.encoding, bank) for s in samples]


def decode_windows(
    decoder: Decoder, code: Tensor, samples: Sequence[TrainingSample], seed: int
) -> list[MapSet]:
    """Maps (1, C, S, S) that a decoder makes of codes (B, CODE_SIZE) for samples."""
    size = samples[0].linear.shape[-1]
    field = fields(decoder.config, [s.waves for s in samples], size, seed, code.device)
    inside = slice(MARGIN, MARGIN + size)
    maps = []
    # One material at a time: AdaIN would split a batch of them in every layer.
    for index, sample in enumerate(samples):
        one = RandomField(field.noise[index, None], tuple(w[index, None] for w in field.waves))
        with mixed(code.device):
            output = decoder(one, code[index])[..., inside, inside]
        maps.append(maps_from_raw(sample.base.apply(output), sample.texel_size))
    return maps


def compare(
    maps: Sequence[MapSet],
    samples: Sequence[TrainingSample],
    wanted: Sequence[Descriptor],
    bank: FilterBank,
) -> tuple[Tensor, Tensor]:
    """(B,) style distances of decoded materials from their windows, and (B,) slope penalties."""
    losses = []
    for one, sample, target in zip(maps, samples, wanted, strict=True):
        with mixed(sample.linear.device):
            described = describe(sample.render(one), sample.encoding, bank)
        losses.append(distance(described, target, Weights()).mean())
    return torch.stack(losses), torch.stack([slope_penalty(one) for one in maps])


def taught(
    maps: Sequence[MapSet], samples: Sequence[TrainingSample], seed: int, bank: FilterBank
) -> Tensor | None:
    """(N,) losses against true maps, of the samples that have them; None if none has."""
    rng = np.random.default_rng([seed, 1])
    losses = []
    for one, sample in zip(maps, samples, strict=True):
        light = side_light(rng)
        if sample.truth is not None:
            relit = relit_distance(one, sample.truth, light, sample.encoding, bank)
            relief = relief_distance(one, sample.truth)
            losses.append((torch.log1p(relit) + _RELIEF * relief)[0])
    return torch.stack(losses) if losses else None


def slope_penalty(maps: MapSet) -> Tensor:
    """Mean squared slope, plus penalties on slopes that are too steep or too fine to be visible."""
    normal = maps.normal
    squared = (normal[..., :2, :, :] / normal[..., 2:, :, :]).square().sum(-3)
    steep = torch.relu((squared + 1e-6).sqrt() - _MOST_SLOPE).square().mean()
    return squared.mean() + _STEEP * steep + _COMB * comb(maps).mean()


def fields(
    config: DecoderConfig,
    waves: Sequence[tuple[Wave, ...]],
    size: int,
    seed: int,
    device: torch.device | str,
) -> RandomField:
    """A batch of fields for windows of `size` texels: noise on a torus, waves endless."""
    side = size + 2 * MARGIN
    torus = Patch(seed, Rectangle(0, 0, side, side), period=(side, side), device=device)
    noise = noise_field(torus, config.noise_channels * len(waves))
    noise = noise.view(len(waves), config.noise_channels, side, side)

    def at(level: int, waves: tuple[Wave, ...]) -> Tensor:
        here = side >> level
        if not waves:
            return torch.zeros(WAVE_CHANNELS, here, here, device=device)
        return wave_field(Patch(seed, Rectangle(0, 0, here, here), level, device=device), waves)

    stack = (torch.stack([at(level, each) for each in waves]) for level in range(DEPTH))
    return RandomField(noise, tuple(stack))


def fits(window: int) -> bool:
    """Whether a window has at least 64 texels a side, and with its margins a multiple of 16."""
    return window >= 64 and (window + 2 * MARGIN) % 2**DEPTH == 0


_LOWEST, _HIGHEST = math.radians(30.0), math.radians(70.0)  # of the light, from the normal
_UNSEEN = 0.02  # root-mean-square slope below which a surface is flat to the eye


def side_light(rng: np.random.Generator) -> Tensor:
    """(3,) random direction of a far light, 30 to 70 degrees from the normal."""
    azimuth, angle = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(_LOWEST, _HIGHEST)
    return torch.tensor(spherical(1.0, angle, azimuth))


def relit_distance(
    estimate: MapSet, truth: MapSet, light: Tensor, encoding: Encoding, bank: FilterBank
) -> Tensor:
    """(B,) style distance of maps (B, C, H, W) from true ones, seen from above under a far light.

    A second teacher: a flash near the lens gives relief so little contrast that a decoder which
    cannot localise it does best without any.

    Each is exposed to the same median: the scale between albedo and flash, ambiguous in one
    photograph, must not count.
    """
    device = truth.height.device
    with torch.no_grad(), mixed(device):
        wanted = describe(_exposed(truth, light, encoding), encoding, bank)
    with mixed(device):
        seen = describe(_exposed(estimate, light, encoding), encoding, bank)
    return distance(seen, wanted, Weights())


def relief_distance(estimate: MapSet, truth: MapSet) -> Tensor:
    """(B,) mean over octaves of the absolute difference of log slope variance."""
    return relief_difference(estimate, truth, _UNSEEN)


def comb(maps: MapSet) -> Tensor:
    """(B,) penalty on texel-to-texel oscillation of height, 0 to 1.

    Normals are central differences, to which heights alternating from texel to texel are invisible.
    Above 0 if most of the slopes' variance is finer than four texels, 1 for pure alternation.
    """
    between, shown = energy_between(maps.height / maps.texel_size), shown_energy(maps)
    return torch.relu(between - 2.0 * shown) / (between + _UNSEEN**2)


def _exposed(maps: MapSet, light: Tensor, encoding: Encoding) -> Tensor:
    """(B, 3, H, W) radiance under a far light, scaled to the encoding's median."""
    incidence = FlashLight.far(light.to(maps.diffuse)).onto(maps.normal, exact=True)
    view = incidence.radiance(maps.diffuse, maps.specular, maps.roughness)
    return view * (encoding.median / view.detach().mean(1).median().clamp_min(1e-6))
