"""What the endless field costs: the decoder's beside the same network in the paper's form, and
the one by example (by_example.py).

The paper's form: instance normalisation over the whole picture, circular padding, a blur after
each upsampling, channels first, weights that nothing is folded into; at matcap's own widths and at
the paper's (width 32, 2.2 million parameters). The two forms run in one process, in turn, so that
their ratio holds whatever else the machine does: in one with the allocator as it comes, then in
another with memory kept for both. With several workers, the field's blocks are computed side by
side on one thread each, and the paper's form uses as many threads for every operator.

Convolution efficiency: multiply-adds a second of a whole block, beside those of plain 3 x 3
convolutions of the same shapes alone.
"""

from __future__ import annotations

import csv
import io
import resource
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields, replace
from multiprocessing import get_context
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.field.blocks import Grid
from matcap.field.field import read_source
from matcap.field.plane import Rectangle, Span
from matcap.field.single import single_threaded
from matcap.files.staging import staged
from matcap.lab.bench.by_example import ExampleCost, example_costs, example_table
from matcap.space.decoder import (
    CODE_SIZE,
    DEPTH,
    PAPER_CONFIG,
    ConvolutionLayer,
    Decoder,
    DecoderConfig,
)
from matcap.space.freeze import FoldedDecoder, FoldedLayer, freeze
from matcap.space.patch import Patch
from matcap.space.random_field import noise_of
from matcap.space.regular_order import WAVE_CHANNELS
from matcap.space.source import BlockSpans, DecoderSource, spans_of_block
from matcap.space.tuned import TunedDecoder
from matcap.synth.precision import multiplies_bfloat16
from matcap.synth.workers import keep_memory

NETWORKS = {"shipped": DecoderConfig(), "paper": PAPER_CONFIG}
BLOCKS = ("256x256", "512x256", "512x512", "1024x256", "1024x1024")
_BLUR = (1.0, 2.0, 1.0)


@dataclass(frozen=True)
class Settings:
    """What is measured.

    Attributes:
        size: (width, height) of the map in texels.
        networks: names in NETWORKS.
        blocks: sizes such as "512x256".
        workers: numbers of threads.
        repeats: of every measurement, of which the median counts.
        exemplar: (width, height) of the piece that is rearranged by example.
    """

    size: tuple[int, int] = (4096, 256)
    networks: tuple[str, ...] = tuple(NETWORKS)
    blocks: tuple[str, ...] = BLOCKS
    workers: tuple[int, ...] = (1, 2)
    repeats: int = 3
    exemplar: tuple[int, int] = (1024, 768)


@dataclass(frozen=True)
class Timing:
    """One measurement.

    Attributes:
        network: a name in NETWORKS.
        allocator: "as it comes" or "kept".
        workers: threads, of both forms.
        block: of the field.
        precision: of the field.
        seconds: of the field, by the wall.
        paper_seconds: of the paper's form beside it.
        processor_seconds, paper_processor_seconds: the same, of all cores together.
    """

    network: str
    allocator: str
    workers: int
    block: str
    precision: str
    seconds: float
    paper_seconds: float
    processor_seconds: float
    paper_processor_seconds: float

    @property
    def ratio(self) -> float:
        """How many times faster than the paper's form, by the wall."""
        return self.paper_seconds / self.seconds

    @property
    def processor_ratio(self) -> float:
        """The same in processor time, which other programs disturb less."""
        return self.paper_processor_seconds / self.processor_seconds


@dataclass(frozen=True)
class Efficiency:
    """Multiply-adds a second on one thread, in thousands of millions.

    Attributes:
        network, precision: which.
        field: of whole blocks, everything counted.
        plain: of plain convolutions of the same shapes.
    """

    network: str
    precision: str
    field: float
    plain: float

    @property
    def share(self) -> float:
        """Of what plain convolutions reach."""
        return self.field / self.plain


@dataclass(frozen=True)
class Report:
    """All of it.

    Attributes:
        rows: the table.
        efficiencies: one a network and precision.
        megabytes: of memory at most, of one process, paper's form and all.
        examples: what the field by example costs.
    """

    rows: list[Timing]
    efficiencies: list[Efficiency]
    megabytes: float
    examples: list[ExampleCost]


def run_synth(settings: Settings, tell: Callable[[str], None]) -> Report:
    """Measure; calls `tell` with a line for each row, when all of an allocator are there."""
    halves = []
    for allocator in ("as it comes", "kept"):
        # A process each: heaps that threads once had are used again, whatever is set later.
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as alone:
            half = alone.submit(_measure, settings, allocator).result()
        for row in half.rows:
            tell(_line(row))
        for one in half.efficiencies:
            tell(f"{one.network} {one.precision}: {one.share:.0%} of plain convolutions")
        halves.append(half)
    return Report(
        [row for half in halves for row in half.rows],
        [one for half in halves for one in half.efficiencies],
        max(half.megabytes for half in halves),
        [one for half in halves for one in half.examples],
    )


def _measure(settings: Settings, allocator: str) -> Report:
    """All rows of an allocator; where memory is kept, the efficiencies too."""
    if allocator == "kept":
        keep_memory()
    materials = {name: material(NETWORKS[name]) for name in settings.networks}
    rows = [row for name, one in materials.items() for row in _rows(name, one, allocator, settings)]
    efficiencies = [
        efficiency(name, one, precision, settings.repeats)
        for name, one in materials.items()
        for precision in _precisions()
        if allocator == "kept"
    ]
    examples = []
    if allocator == "kept":
        examples = list(
            example_costs(settings.size, settings.exemplar, settings.workers, settings.repeats)
        )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return Report(rows, efficiencies, peak / (1e6 if sys.platform == "darwin" else 1e3), examples)


def material(config: DecoderConfig) -> TunedDecoder:
    """A decoder of random weights: what it costs does not depend on them."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        decoder = Decoder(config).eval().requires_grad_(False)
    code = torch.zeros(CODE_SIZE)
    moments = tuple(freeze(decoder, code, ()))
    return TunedDecoder(decoder, code, moments, (), 2 / 1024)


def paper_form(decoder: Decoder, code: Tensor, noise: Tensor) -> Tensor:
    """The network as the paper has it, on a whole periodic field (1, C, H, W); without waves."""

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


def efficiency(name: str, subject: TunedDecoder, precision: str, repeats: int) -> Efficiency:
    """Multiply-adds a second of one block and of its convolutions alone, on one thread."""
    source = _source(subject, Grid(), precision)
    block = Rectangle(0, 0, source.grid.width, source.grid.height)
    shapes = list(_convolutions(source.decoder, spans_of_block(block, source.decoder.convolutions)))
    count = sum(
        weight.numel()
        * (part.shape[2] - weight.shape[2] + 1)
        * (part.shape[3] - weight.shape[3] + 1)
        for part, weight in shapes
    )

    def plain() -> None:
        with torch.inference_mode():
            for part, weight in shapes:
                F.conv2d(part, weight)

    with single_threaded(1) as pool:
        times = [
            (
                pool.submit(_processor, lambda: source.maps(block)).result(),
                pool.submit(_processor, plain).result(),
            )
            for _ in range(max(repeats, 2))
        ]
    ours, theirs = (min(column) for column in zip(*times, strict=True))
    return Efficiency(name, precision, count / ours / 1e9, count / theirs / 1e9)


def write_report(report: Report, out: Path, command: str) -> None:
    """Write synth.md and synth.csv into a folder.

    Raises:
        MatcapError: the folder cannot be written.
    """
    with staged(out) as stage:
        (stage / "synth.md").write_text(markdown(report, command))
        (stage / "synth.csv").write_text(comma_separated(report))


def markdown(report: Report, command: str) -> str:
    """The report as a section of documentation."""
    lines = [
        f"Measured by `{command}`. Ratios are how many times as long the paper's form takes.",
        "",
        "| network | allocator | workers | block | precision | s | paper's form s | ratio "
        "| ratio of processor time |",
        "|---|---|---:|---|---|---:|---:|---:|---:|",
        *(_line(row) for row in report.rows),
        "",
        "| network | precision | 10^9 multiply-adds/s | plain convolutions | share |",
        "|---|---|---:|---:|---:|",
        *(
            f"| {one.network} | {one.precision} | {one.field:.1f} | {one.plain:.1f} "
            f"| {one.share:.0%} |"
            for one in report.efficiencies
        ),
        "",
        *example_table(report.examples),
        "",
        f"Peak memory of the whole benchmark: {report.megabytes:.0f} MB.",
    ]
    return "\n".join(lines) + "\n"


def comma_separated(report: Report) -> str:
    """The rows as CSV."""
    text = io.StringIO()
    names = [field.name for field in fields(Timing)]
    table = csv.DictWriter(text, [*names, "ratio", "processor_ratio"], lineterminator="\n")
    table.writeheader()
    for row in report.rows:
        table.writerow(asdict(row) | {"ratio": row.ratio, "processor_ratio": row.processor_ratio})
    return text.getvalue()


def _rows(name: str, subject: TunedDecoder, allocator: str, settings: Settings) -> Iterator[Timing]:
    width, height = settings.size
    config = subject.decoder.config
    noise = noise_of(Patch(1, Rectangle(0, 0, width, height)), config.noise_channels, config.grains)
    noise = noise[None]
    noise = noise.contiguous()
    for workers in settings.workers:
        for block in settings.blocks:
            for precision in _precisions():
                source = _source(subject, _grid(block), precision)

                def ours(source: DecoderSource = source, workers: int = workers) -> None:
                    read_source(source, Rectangle(0, 0, width, height), workers)

                def theirs(workers: int = workers) -> None:
                    torch.set_num_threads(workers)
                    with torch.inference_mode():
                        paper_form(subject.decoder, subject.code, noise)

                wall, processor = _in_turn((ours, theirs), settings.repeats)
                yield Timing(name, allocator, workers, block, precision, *wall, *processor)


def _in_turn(calls: Sequence[Callable[[], None]], repeats: int) -> tuple[list[float], list[float]]:
    """Median seconds of each by the wall and by the processor, one after the other each time."""
    wall: list[list[float]] = [[] for _ in calls]
    processor: list[list[float]] = [[] for _ in calls]
    for _ in range(repeats):
        for index, call in enumerate(calls):
            started, worked = time.perf_counter(), time.process_time()
            call()
            wall[index].append(time.perf_counter() - started)
            processor[index].append(time.process_time() - worked)
    return [statistics.median(t) for t in wall], [statistics.median(t) for t in processor]


def _convolutions(decoder: FoldedDecoder, spans: BlockSpans) -> Iterator[tuple[Tensor, Tensor]]:
    """Random features and the weights they meet, of every convolution of a block."""
    rows, columns = spans.rows, spans.columns
    steps: list[tuple[FoldedLayer, Span, Span]] = [(decoder.head, rows.output, columns.output)]
    for blocks, high, wide in (
        (decoder.down, rows.down, columns.down),
        (decoder.up[::-1], rows.joined, columns.joined),
    ):
        for block, height, width in zip(blocks, high, wide, strict=True):
            steps += [
                (layer, height.grown(-index), width.grown(-index))
                for index, layer in enumerate(block)
            ]
    for layer, height, width in steps:
        for weight in layer.weights:
            features = torch.rand(1, weight.shape[1], height.size, width.size).to(weight.dtype)
            yield features.contiguous(memory_format=torch.channels_last), weight


def _processor(call: Callable[[], object]) -> float:
    """Seconds of this thread."""
    start = time.thread_time()
    call()
    return time.thread_time() - start


def _source(subject: TunedDecoder, grid: Grid, precision: str) -> DecoderSource:
    source = replace(subject.source(1), grid=grid)
    return source if precision == "fp32" else source.lowered(0)


def _precisions() -> tuple[str, ...]:
    return ("fp32", "bf16") if multiplies_bfloat16(torch.device("cpu")) else ("fp32",)


def _grid(block: str) -> Grid:
    width, height = block.split("x")
    return Grid(int(width), int(height))


def _blurred(features: Tensor) -> Tensor:
    """A 3 x 3 binomial blur of a periodic picture, channel by channel."""
    channels = features.shape[1]
    line = torch.tensor(_BLUR) / sum(_BLUR)
    kernel = (line[:, None] * line).expand(channels, 1, 3, 3).contiguous()
    padded = F.pad(features, (1, 1, 1, 1), mode="circular")
    return F.conv2d(padded, kernel, groups=channels)


def _line(row: Timing) -> str:
    return (
        f"| {row.network} | {row.allocator} | {row.workers} | {row.block} | {row.precision} "
        f"| {row.seconds:.2f} | {row.paper_seconds:.2f} | {row.ratio:.2f} "
        f"| {row.processor_ratio:.2f} |"
    )
