"""Training the prior: encoder and decoder together, as a VAE on flash photographs alone.

Each step takes a few materials. The encoder sees each whole photograph, a code is drawn, the
decoder turns fresh noise and that code into maps, and the maps are lit and seen as at several
places of the photograph and compared with what is there (statistics/compare.py). A KL term, warmed
up, keeps codes near a standard normal.

Everything random in a step follows from (seed, step), so weights, optimiser and step are the whole
state: a run killed at any time goes on from its last checkpoint as if nothing had happened.
Imports torch, numpy, cv2 and safetensors alone. Runs on the CPU and on CUDA, both in bfloat16.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from matcap.brdf.maps import MapSet
from matcap.model.decoder import DEPTH, Decoder, DecoderConfig, maps_from_raw
from matcap.model.encoder import Encoder, EncoderConfig
from matcap.model.field import RandomField
from matcap.model.noise import noise_field
from matcap.model.order import WAVE_CHANNELS, Wave, wave_field
from matcap.prior.base import Base, start_head
from matcap.prior.checkpoint import load_checkpoint, save_checkpoint
from matcap.prior.journal import Journal
from matcap.prior.look import FEATURES, texture
from matcap.prior.pack import Entry, Pack
from matcap.prior.windows import Sample, Source, Turn, cut, prepare
from matcap.statistics.compare import Descriptor, Weights, describe, distance
from matcap.statistics.filterbank import FilterBank

MARGIN = 16  # texels cut off each side of what is decoded: its border is not valid

_MOST_SLOPE = 1.0  # of a surface, root mean square at a texel, before it is held back hard


@dataclass(frozen=True)
class TrainConfig:
    """How a prior is trained; a TOML file of the same names (cli/prior.py).

    Attributes:
        steps: when training ends; the learning rate falls to nothing over the last quarter.
        materials: photographs of different materials in a step.
        places: windows of each.
        window: texels a side, MARGIN short of a multiple of 16 on either side.
        real_share: of the photographs drawn that are real.
        coarse_share: of the photographs drawn that are looked at with half the detail.
        rate, encoder_rate: Adam's, of decoder and encoder.
        weight_decay: Adam's.
        kl: weight of the KL term, per dimension of the code.
        kl_warmup: steps until it counts in full.
        slope: weight of the mean squared slope.
        average: decay of the running mean of the weights, which is what is shipped.
        seed: of everything random.
        checkpoint_minutes: between checkpoints.
        report_every: steps between reports on the held-out materials.
        encoder, decoder: their shapes.
    """

    steps: int = 6000
    materials: int = 4
    places: int = 2
    window: int = 160
    real_share: float = 0.65
    coarse_share: float = 0.15
    rate: float = 2e-3
    encoder_rate: float = 5e-4
    weight_decay: float = 1e-5
    kl: float = 0.03
    kl_warmup: int = 1000
    slope: float = 0.02
    average: float = 0.998
    seed: int = 1
    checkpoint_minutes: float = 4.0
    report_every: int = 250
    encoder: EncoderConfig = EncoderConfig()
    decoder: DecoderConfig = DecoderConfig()


class Model(nn.Module):
    """Encoder and decoder."""

    def __init__(self, encoder: EncoderConfig, decoder: DecoderConfig) -> None:
        super().__init__()
        self.encoder = Encoder(encoder)
        self.decoder = Decoder(decoder)
        start_head(self.decoder)


@dataclass
class State:
    """All that training changes."""

    model: Model
    average: Model
    optimiser: torch.optim.Adam
    step: int = 0


def train(
    pack: Pack,
    config: TrainConfig,
    out: Path,
    *,
    resume: bool = False,
    device: str = "cpu",
    tell: Callable[[str], None] = lambda line: None,
) -> State:
    """Train until config.steps, writing checkpoints, curves and pictures into a folder.

    Raises:
        MatcapError: the checkpoint to resume from is missing, broken or of another shape.
    """
    state = start(config, device)
    if resume:
        load_checkpoint(out / "checkpoint.safetensors", state)
    out.mkdir(parents=True, exist_ok=True)
    journal = Journal(out, state.step)
    sources: dict[str, Source] = {}

    def source(entry: Entry) -> Source:
        if entry.name not in sources:
            sources[entry.name] = prepare(entry, config.encoder.width)
        return sources[entry.name]

    bank = FilterBank(FEATURES)
    saved = time.monotonic()
    while state.step < config.steps:
        rng = np.random.default_rng([config.seed, state.step])
        turn = Turn(bool(rng.integers(2)), int(rng.integers(4)))
        samples = [
            cut(
                source(entry), config.window, config.places,
                2 if rng.random() < config.coarse_share else 1, turn, rng,
            )
            for entry in draw(pack.training, config, rng)
        ]  # fmt: skip
        journal.note(state.step, train_step(state, samples, config, bank, device))
        if state.step % config.report_every == 0 or state.step == config.steps:
            journal.report(state, pack, source, config, bank, device)
            tell(journal.line)
        if time.monotonic() - saved > 60.0 * config.checkpoint_minutes:
            save_checkpoint(out / "checkpoint.safetensors", state)
            saved = time.monotonic()
    save_checkpoint(out / "checkpoint.safetensors", state)
    return state


def start(config: TrainConfig, device: str) -> State:
    """An untrained state."""
    torch.manual_seed(config.seed)
    model = Model(config.encoder, config.decoder)
    average = Model(config.encoder, config.decoder)
    average.load_state_dict(model.state_dict())
    for module in (model, average):
        module.to(device=device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimiser = torch.optim.Adam(
        [
            {"params": list(model.encoder.parameters()), "lr": config.encoder_rate},
            {"params": list(model.decoder.parameters()), "lr": config.rate},
        ],
        betas=(0.9, 0.99),
        weight_decay=config.weight_decay,
    )
    return State(model, average.requires_grad_(False), optimiser)


def draw(entries: Sequence[Entry], config: TrainConfig, rng: np.random.Generator) -> list[Entry]:
    """Different materials, each material as likely as another, then one photograph of each."""
    kinds: dict[bool, dict[str, list[Entry]]] = {True: {}, False: {}}
    for entry in entries:
        kinds[entry.simulated].setdefault(entry.material, []).append(entry)
    chosen: dict[str, Entry] = {}
    while len(chosen) < min(config.materials, sum(len(k) for k in kinds.values())):
        simulated = not kinds[False] or (bool(kinds[True]) and rng.random() >= config.real_share)
        materials = kinds[simulated]
        material = list(materials)[int(rng.integers(len(materials)))]
        pictures = materials[material]
        chosen[material] = pictures[int(rng.integers(len(pictures)))]
    return list(chosen.values())


def train_step(
    state: State, samples: list[Sample], config: TrainConfig, bank: FilterBank, device: str
) -> dict[str, float]:
    """One step of Adam; returns the parts of the loss."""
    factor = schedule(state.step, config.steps)
    for group, rate in zip(
        state.optimiser.param_groups, (config.encoder_rate, config.rate), strict=True
    ):
        group["lr"] = rate * factor
    pictures = torch.stack([s.picture for s in samples]).to(device)
    numbers = torch.stack([s.numbers for s in samples]).to(device)
    wanted = targets(samples, bank, device)
    told = torch.stack([texture(target) for target in wanted])
    with torch.autocast(torch.device(device).type, torch.bfloat16):
        mean, log_variance = state.model.encoder(pictures, numbers, told)
    noise_seed = config.seed * 1_000_003 + state.step
    generator = torch.Generator().manual_seed(noise_seed)
    drawn = torch.randn(mean.shape, generator=generator).to(device)
    code = mean + torch.exp(0.5 * log_variance) * drawn
    losses, slopes = compare(state.model.decoder, code, samples, wanted, noise_seed, bank, device)
    kl = 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).mean()
    warm = min(1.0, state.step / max(1, config.kl_warmup))
    # The logarithm keeps one plain material, whose faint statistics are easily missed by a large
    # factor, from drowning the others.
    loss = torch.log1p(losses).mean() + config.kl * warm * kl + config.slope * slopes.mean()
    state.optimiser.zero_grad(set_to_none=True)
    loss.backward()
    nn.utils.clip_grad_norm_(state.model.parameters(), 1.0)
    state.optimiser.step()
    state.step += 1
    decay = min(config.average, state.step / (state.step + 10.0))
    with torch.no_grad():
        for kept, new in zip(state.average.parameters(), state.model.parameters(), strict=True):
            kept.lerp_(new, 1.0 - decay)
    parts = {"style": torch.log1p(losses).mean(), "kl": kl, "slope": slopes.mean()}
    return {name: float(value.detach()) for name, value in parts.items()}


def schedule(step: int, steps: int) -> float:
    """Share of the learning rate: a short warm-up, flat, and down over the last quarter."""
    return min(1.0, (step + 1) / 50.0) * min(1.0, max(0.02, 4.0 * (1.0 - step / steps)))


def targets(samples: Sequence[Sample], bank: FilterBank, device: str) -> list[Descriptor]:
    """What the windows of each sample look like."""
    kind = torch.device(device).type
    with torch.no_grad(), torch.autocast(kind, torch.bfloat16):
        return [describe(s.linear.to(device), s.encoding, bank) for s in samples]


def compare(
    decoder: Decoder,
    code: Tensor,
    samples: Sequence[Sample],
    wanted: Sequence[Descriptor],
    seed: int,
    bank: FilterBank,
    device: str,
) -> tuple[Tensor, Tensor]:
    """(B,) style distances of decoded materials from their windows, and (B,) slope penalties."""
    kind = torch.device(device).type
    size = samples[0].linear.shape[-1]
    field = fields(decoder.config.noise_channels, [s.waves for s in samples], size, seed, device)
    with torch.autocast(kind, torch.bfloat16):
        output = decoder(field, code)
    inner = output[..., MARGIN : MARGIN + size, MARGIN : MARGIN + size]
    losses, slopes = [], []
    for index, sample in enumerate(samples):
        sample = sample.to(device)
        maps = read_maps(inner[index : index + 1], sample.base, sample.texel_size)
        with torch.autocast(kind, torch.bfloat16):
            found = describe(sample.render(maps), sample.encoding, bank)
        losses.append(distance(found, wanted[index], Weights()).mean())
        slopes.append(slope_penalty(maps))
    return torch.stack(losses), torch.stack(slopes)


def read_maps(output: Tensor, base: Base, texel_size: float) -> MapSet:
    """Maps of decoder outputs (B, OUTPUTS, H, W) that are in units of a base."""
    return maps_from_raw(base.apply(output), texel_size)


def slope_penalty(maps: MapSet) -> Tensor:
    """Mean squared slope, and much more where slopes exceed what a flash can show."""
    normal = maps.normal
    squared = (normal[..., :2, :, :] / normal[..., 2:, :, :]).square().sum(-3)
    steep = torch.relu((squared + 1e-6).sqrt() - _MOST_SLOPE).square().mean()
    return squared.mean() + 15.0 * steep


def fields(
    channels: int, waves: Sequence[tuple[Wave, ...]], size: int, seed: int, device: str
) -> RandomField:
    """A batch of fields for windows of `size` texels: noise on a torus, waves endless."""
    side = size + 2 * MARGIN
    noise = noise_field(
        seed, channels * len(waves), 0, 0, side, side, period=(side, side), device=device
    ).view(len(waves), channels, side, side)
    stack = []
    for level in range(DEPTH):
        here = side >> level
        stack.append(
            torch.stack(
                [
                    wave_field(seed, w, 0, 0, here, here, level=level, device=device)
                    if w
                    else torch.zeros(WAVE_CHANNELS, here, here, device=device)
                    for w in waves
                ]
            )
        )
    return RandomField(noise, tuple(stack))


def fits(window: int) -> bool:
    """Whether a window with its margins is a multiple of 16 texels, and large enough to tell."""
    return window >= 64 and (window + 2 * MARGIN) % 2**DEPTH == 0
