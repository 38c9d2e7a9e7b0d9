"""One training step: loss of decoded windows against windows of photographs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.brdf.slopes import energy_between, relief_difference, shown_energy
from matcap.field.plane import Rectangle
from matcap.flash.light import FlashLight
from matcap.lab.measures.lights import spherical
from matcap.lab.train.state import Model, TrainConfig
from matcap.lab.train.trainer import mixed
from matcap.lab.train.training_windows import TrainingSample
from matcap.space.decoder import DEPTH, Decoder, DecoderConfig, maps_from_raw
from matcap.space.lattice_channels import WAVE_CHANNELS, wave_field
from matcap.space.noise import noise_field
from matcap.space.patch import Patch
from matcap.space.prior.encoder_input import texture
from matcap.space.random_field import RandomField
from matcap.statistics.compare import Descriptor, Weights, describe, distance
from matcap.statistics.encoding import Encoding
from matcap.statistics.filterbank import FilterBank
from matcap.statistics.lattice import Wave

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
    maps: Sequence[MapSet],
    samples: Sequence[TrainingSample],
    seed: int,
    bank: FilterBank,
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
    estimate: MapSet,
    truth: MapSet,
    light: Tensor,
    encoding: Encoding,
    bank: FilterBank,
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
