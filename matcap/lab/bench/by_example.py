"""What the field by example costs: its index once, what is looked up at every start, its blocks."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.maps import CHANNELS
from matcap.example.example import Example
from matcap.example.exemplar import Exemplar
from matcap.field.field import read_source
from matcap.field.plane import Rectangle
from matcap.lab.simulate.materials import realise

_MATERIAL = "leather"  # without order: the dearer kind
_SEED = 11


@dataclass(frozen=True)
class ExampleCost:
    """What one step costs.

    Attributes:
        step: what is done.
        seconds: by the wall.
        processor_seconds: of all cores together.
        megatexels: that it makes, or 0.
    """

    step: str
    seconds: float
    processor_seconds: float
    megatexels: float = 0.0


def true_exemplar(
    material: str, width: int, height: int, seed: int = _SEED, detail: int = 1024
) -> Exemplar:
    """The true maps of a simulated material as an exemplar that is trusted everywhere."""
    maps = realise(material, width, height, seed, 2.0 / detail)
    found = {name: getattr(maps, name).float().numpy() for name in CHANNELS}
    trusted = np.ones((len(CHANNELS), height, width), np.float32)
    return Exemplar(**found, confidence=trusted, texel_size=2.0 / detail)


def example_costs(
    size: tuple[int, int], exemplar: tuple[int, int], workers: tuple[int, ...], repeats: int
) -> Iterator[ExampleCost]:
    """Measure.

    Args:
        size: (width, height) of a map in texels; a square of it and one of 16 times that, too.
        exemplar: (width, height).
        workers: numbers of threads.
        repeats: of which the median counts.
    """
    piece = true_exemplar(_MATERIAL, *exemplar)
    made: list[Example] = []
    yield _timed("index", lambda: made.append(Example.of(piece)), 1)
    tensors, about = made[0].stored()
    index = sum(len(data) for name, data in tensors.items() if name.startswith("index."))
    yield ExampleCost(f"file: index {index / 1e6:.2f} MB of {_bytes(tensors):.2f} MB", 0.0, 0.0)

    def ready() -> None:
        made.append(Example.read(about, tensors.__getitem__))
        made[-1].source(0).maps(Rectangle(0, 0, 16, 16))

    yield _timed("unpack and prepare", ready, repeats)
    source = made[-1].source(1)
    side = round((size[0] * size[1]) ** 0.5)
    for width, height in (size, (side, side), (4 * side, 4 * side)):
        wanted = Rectangle(0, 0, width, height)
        for count in workers:

            def read(wanted: Rectangle = wanted, count: int = count) -> None:
                read_source(source, wanted, count)

            name = f"{width}x{height}, {count} workers"
            yield _timed(name, read, repeats, width * height / 1e6)


def example_table(costs: list[ExampleCost]) -> list[str]:
    """The lines of a table."""
    return [
        "| by example | s | s of all cores | s of one core a megatexel |",
        "|---|---:|---:|---:|",
        *(
            f"| {one.step} | {one.seconds:.2f} | {one.processor_seconds:.2f} "
            f"| {one.processor_seconds / one.megatexels:.2f} |"
            if one.megatexels
            else f"| {one.step} | {one.seconds:.2f} | {one.processor_seconds:.2f} | |"
            for one in costs
        ),
    ]


def _timed(
    step: str, call: Callable[[], object], repeats: int, megatexels: float = 0.0
) -> ExampleCost:
    wall, processor = [], []
    for _ in range(repeats):
        started, worked = time.perf_counter(), time.process_time()
        call()
        wall.append(time.perf_counter() - started)
        processor.append(time.process_time() - worked)
    return ExampleCost(step, statistics.median(wall), statistics.median(processor), megatexels)


def _bytes(tensors: dict[str, NDArray[np.uint8]]) -> float:
    return sum(len(data) for data in tensors.values()) / 1e6
