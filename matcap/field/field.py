"""Field: random access to the endless material, and the device that computes its blocks."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

import torch

from matcap.brdf.maps import MapSet
from matcap.errors import UsageError
from matcap.field.plane import BLOCK, BlockPart, Period, Rectangle, block_parts, check_rectangle
from matcap.field.source import MAP_CHANNELS, Generated, Generator, Source, inner
from matcap.files.threads import single_threaded
from matcap.files.threads import workers as most

# The device that computes blocks: the processor or CUDA, and its support of bfloat16.

# Their results differ by about 1e-6. An output that was begun on one is therefore never continued
# on the other (synth/request.py).

DeviceName = Literal["auto", "cpu", "cuda"]

_SETTINGS_LOCK = threading.Lock()


def find_device(name: DeviceName) -> torch.device:
    """Return the torch device; "auto" is CUDA where available, else the processor.

    Of several CUDA devices torch's current one is used; set CUDA_VISIBLE_DEVICES for another.

    Raises:
        UsageError: "cuda", and torch sees no such device.
    """
    there = torch.cuda.is_available()
    if name == "cuda" and not there:
        raise UsageError.at(
            "--device",
            "PyTorch sees no CUDA device",
            "use cpu, or install a CUDA driver and a PyTorch built for it",
        )
    return torch.device("cuda" if there and name != "cpu" else "cpu")


@contextmanager
def repeatable(device: torch.device) -> Iterator[None]:
    """Context in which convolutions on CUDA are float32 and deterministic; no-op on the processor.

    By default cuDNN rounds float32 to TF32, and may choose its algorithm by timing. The settings
    belong to the process, hence one thread at a time holds the context.
    """
    if device.type != "cuda":
        yield
        return
    settings: Any = torch.backends.cudnn
    with _SETTINGS_LOCK:
        before = settings.conv.fp32_precision, settings.deterministic, settings.benchmark
        try:
            # Not `allow_tf32`: it does not hold where torch.backends.fp32_precision says TF32.
            settings.conv.fp32_precision = "ieee"
            settings.deterministic, settings.benchmark = True, False
            yield
        finally:
            settings.conv.fp32_precision, settings.deterministic, settings.benchmark = before


def computes_bfloat16() -> bool:
    """Whether the processor has bfloat16 instructions; emulated ones are slower than float32."""
    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())


# The plane is cut into a fixed grid of blocks. A block is always computed whole, from the same
# inputs, on one thread. Its texels therefore have the same bits whatever rectangle is read, in
# whatever order, and however many blocks are computed in parallel.
#
# Read next: source.py (one block), synth/stream.py (rectangles of any size, to files).

__all__ = ["BLOCK", "Field", "Rectangle"]


class Field:
    """The endless field of one material and seed.

    Args:
        material: the material to synthesise.
        seed: of the realisation, in [-2^63, 2^63).
        period: repeat in texels along (x, y), multiples of the material's alignment; None, for
            both axes or for one, is endless.
        device: "cpu", "cuda", or "auto" for CUDA where available. Devices differ in the last bits.
            Maps are returned on the processor. The example generator always uses the processor.
        generator: "example" or "decoder"; None is the material's default.

    Raises:
        UsageError: a seed or period out of range, no CUDA device, or a generator that the material
            does not have.
    """

    def __init__(
        self,
        material: Generated,
        seed: int = 0,
        period: Period | None = None,
        *,
        device: DeviceName = "cpu",
        generator: Generator | None = None,
    ) -> None:
        place = find_device(device)
        self.source: Source = material.by(generator).generator.source(seed, period, place)

    def read(
        self, x: int, y: int, width: int, height: int, *, workers: int | None = None
    ) -> MapSet:
        """Compute the maps of a rectangle.

        Normals of the result are finite differences of the height inside the rectangle. A rectangle
        of exactly one period is marked periodic.

        Args:
            x, y: upper left texel; y grows downwards.
            width, height: in texels.
            workers: blocks computed in parallel, by default one a core; changes no bit.

        Raises:
            UsageError: an empty rectangle, or coordinates beyond 2^40.
        """
        wanted = check_rectangle(Rectangle(x, y, width, height))
        return read_source(self.source, wanted, workers or most())


def read_source(source: Source, wanted: Rectangle, workers: int) -> MapSet:
    """Compute the maps of a rectangle with `workers` threads; see Field.read."""
    channels = MAP_CHANNELS + source.specular_channels
    stacked = torch.empty(channels, wanted.height, wanted.width)
    parts: dict[Rectangle, list[BlockPart]] = {}  # a block that repeats is computed once
    for part in block_parts(wanted, source.grid, source.period):
        parts.setdefault(part.block, []).append(part)

    def fill(block: Rectangle) -> None:
        # Threads do not inherit the caller's inference mode.
        with torch.inference_mode():
            planes = inner(source.maps(block)).cpu()
            for part in parts[block]:
                stacked[(..., *part.target)] = planes[(..., *part.source)]

    with single_threaded(min(workers, len(parts))) as pool:
        list(pool.map(fill, parts))
    whole = source.period == (wanted.width, wanted.height)
    return MapSet.from_stacked(stacked, source.texel_size, periodic=whole)
