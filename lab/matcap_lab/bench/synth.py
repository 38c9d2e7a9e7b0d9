"""`matcap-lab bench synth`: speed of synthesis, by the decoder and by example.

The decoder is compared with the same network in the paper's form: instance normalisation over the
whole picture, circular padding, a blur after each upsampling, channels first, unfolded weights; at
matcap's own widths and at the paper's (width 32, 2.2 million parameters). The two forms alternate
in one process, so that load of the machine cancels in their ratio. With several workers, the
field's blocks run in parallel on one thread each, and the paper's form uses as many threads for
every operator.
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from multiprocessing import get_context

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.example.example import Example
from matcap.example.exemplar import Exemplar
from matcap.field.field import read_source
from matcap.field.plane import Grid, Rectangle
from matcap.files.process import keep_memory
from matcap.space.decoder import CODE_SIZE, DEPTH, ConvolutionLayer, Decoder, DecoderConfig
from matcap.space.freeze import freeze
from matcap.space.random_field import WAVE_CHANNELS, Patch, noise_field
from matcap.space.tuned import TunedDecoder
from matcap_lab.bench.floors import true_exemplar
from matcap_lab.experiment.results import Value
from matcap_lab.experiment.runner import Configuration, Experiment, in_turn

ABOUT = (
    "Seconds: wall time; processor: time of all cores; paper: of the paper's form of the network; "
    "ratio: of these, also in processor time, which other programs disturb less. By example: "
    "processor seconds per megatexel. Megabytes: peak memory of the process."
)
# The paper's configuration at width 32; 2.2 million parameters.
PAPER_CONFIG = DecoderConfig(noise_channels=6, widths=(32, 64, 128, 128, 128), convolutions=(2, 2))
NETWORKS = {"shipped": DecoderConfig(), "paper": PAPER_CONFIG}
BLOCKS = ("256x256", "512x256", "512x512", "1024x256", "1024x1024")
BY_NETWORK, BY_EXAMPLE = "by network", "by example"
_BLUR = (1.0, 2.0, 1.0)
_MATERIAL = "leather"  # without a lattice, so that synthesis costs more


@dataclass(frozen=True)
class SynthSettings:
    """Sizes, networks and numbers of threads."""

    size: tuple[int, int] = (4096, 256)
    """(width, height) of the map in texels."""
    networks: tuple[str, ...] = tuple(NETWORKS)
    """Names in NETWORKS."""
    blocks: tuple[str, ...] = BLOCKS
    """Sizes such as "512x256"."""
    workers: tuple[int, ...] = (1, 2)
    """Numbers of threads."""
    repeats: int = 3
    """Repeats of every measurement; the median counts."""
    exemplar: tuple[int, int] = (1024, 768)
    """(width, height) of the exemplar, texels."""


@dataclass(frozen=True)
class SynthSubject:
    """A network by name, or an exemplar."""

    name: str
    exemplar_size: tuple[int, int]

    @cached_property
    def exemplar(self) -> Exemplar:
        """Exemplar of true maps."""
        return true_exemplar(_MATERIAL, *self.exemplar_size)

    @cached_property
    def example(self) -> Example:
        """The exemplar, indexed for synthesis."""
        return Example.of(self.exemplar)


Costs = Mapping[str, Value]


def synth_experiment(settings: SynthSettings) -> Experiment[SynthSubject, Costs]:
    """Every network by every number of workers and block; and by example."""
    configurations: dict[str, Configuration[SynthSubject, Costs]] = {}
    for workers in settings.workers:
        for block in settings.blocks:
            run = partial(_alone, settings, workers, block)
            configurations[f"{workers} workers, {block}"] = Configuration(run, BY_NETWORK)
    for name, step in _steps(settings).items():
        configurations[name] = Configuration(step, BY_EXAMPLE)
    names = (*settings.networks, BY_EXAMPLE)
    return Experiment(
        "synth",
        {name: partial(SynthSubject, name, settings.exemplar) for name in names},
        configurations,
        settings=settings,
        skips=lambda subject, name: (
            (subject == BY_EXAMPLE) != (configurations[name].group == BY_EXAMPLE)
        ),
    )


def _alone(
    settings: SynthSettings, workers: int, block: str, subject: SynthSubject, _seed: int
) -> Costs:
    """Costs in a new process, whose memory is its own."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as alone:
        return alone.submit(field_costs, subject.name, settings, workers, block).result()


def field_costs(network: str, settings: SynthSettings, workers: int, block: str) -> Costs:
    """Costs of the field and of the paper's form of the same network, named in NETWORKS."""
    keep_memory()
    subject, (width, height) = material(NETWORKS[network]), settings.size
    config = subject.decoder.config
    noise = noise_field(Patch(1, Rectangle(0, 0, width, height)), config.noise_channels)
    noise = noise[None].contiguous()
    source = replace(subject.source(1), grid=Grid(*map(int, block.split("x"))))

    def ours() -> None:
        read_source(source, Rectangle(0, 0, width, height), workers)

    def theirs() -> None:
        torch.set_num_threads(workers)
        with torch.inference_mode():
            paper_form(subject.decoder, subject.code, noise)

    (seconds, paper), (processor, paper_processor) = in_turn((ours, theirs), settings.repeats)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {
        "seconds": seconds,
        "paper": paper,
        "ratio": paper / seconds,
        "processor": processor,
        "processor ratio": paper_processor / processor,
        "megabytes": peak / (1e6 if sys.platform == "darwin" else 1e3),
    }


def _steps(settings: SynthSettings) -> dict[str, Callable[[SynthSubject, int], Costs]]:
    """Steps of synthesis by example, by name: index (once), start, texels."""

    def index(subject: SynthSubject, _seed: int) -> Costs:
        return _costs(lambda: Example.of(subject.exemplar), 1)

    def ready(subject: SynthSubject, _seed: int) -> Costs:
        tensors, about = subject.example.stored()

        def read() -> None:
            Example.read(about, tensors.__getitem__).source(0).maps(Rectangle(0, 0, 16, 16))

        return _costs(read, settings.repeats)

    def texels(size: tuple[int, int], workers: int, subject: SynthSubject, _seed: int) -> Costs:
        source, wanted = subject.example.source(1), Rectangle(0, 0, *size)
        cost = _costs(lambda: read_source(source, wanted, workers), settings.repeats)
        each = float(cost["processor"]) * 1e6 / (size[0] * size[1])
        return {**cost, "a megatexel": each}

    steps: dict[str, Callable[[SynthSubject, int], Costs]] = {
        "index": index, "unpack and prepare": ready
    }  # fmt: skip
    side = round((settings.size[0] * settings.size[1]) ** 0.5)
    for size in (settings.size, (side, side), (4 * side, 4 * side)):
        for workers in settings.workers:
            name = f"{size[0]}x{size[1]}, {workers} workers"
            steps[name] = partial(texels, size, workers)
    return steps


def _costs(call: Callable[[], object], repeats: int) -> Costs:
    (seconds,), (processor,) = in_turn((call,), repeats)
    return {"seconds": seconds, "processor": processor}


def material(config: DecoderConfig) -> TunedDecoder:
    """A decoder of random weights, which do not affect its cost."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        decoder = Decoder(config).eval().requires_grad_(False)
    code = torch.zeros(CODE_SIZE)
    return TunedDecoder(decoder, code, tuple(freeze(decoder, code, ())), (), 2 / 1024)


def paper_form(decoder: Decoder, code: Tensor, noise: Tensor) -> Tensor:
    """The network in the paper's form, on a whole periodic field (1, C, H, W); without waves."""

    def step(layer: ConvolutionLayer, features: Tensor, weight: Tensor) -> Tensor:
        if weight.shape[-1] > 1:
            features = F.pad(features, (1, 1, 1, 1), mode="circular")
        features = F.conv2d(features, weight)
        mean, deviation = layer.adain.target(code)
        features = F.instance_norm(features) * deviation[:, None, None] + mean[:, None, None]
        return F.relu(features) if layer.activate else features

    features, skips = noise, []
    for level, block in enumerate(decoder.down_layers()):
        if level > 0:
            features = F.max_pool2d(features, 2)
        for layer in block:
            features = step(layer, features, layer.convolution.weight.contiguous())
        skips.append(features)
    for level, block in zip(reversed(range(DEPTH)), decoder.up_layers(), strict=True):
        features = F.interpolate(features, scale_factor=2, mode="bilinear", align_corners=False)
        features = torch.cat([_blurred(features), skips[level]], dim=1)
        for index, layer in enumerate(block):
            weight = layer.convolution.weight
            features = step(
                layer, features, (weight if index else weight[:, :-WAVE_CHANNELS]).contiguous()
            )
    return step(decoder.head, features, decoder.head.convolution.weight.contiguous())


def _blurred(features: Tensor) -> Tensor:
    """A 3 x 3 binomial blur of a periodic picture, channel by channel."""
    channels = features.shape[1]
    line = torch.tensor(_BLUR) / sum(_BLUR)
    kernel = (line[:, None] * line).expand(channels, 1, 3, 3).contiguous()
    return F.conv2d(F.pad(features, (1, 1, 1, 1), mode="circular"), kernel, groups=channels)
