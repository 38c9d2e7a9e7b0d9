"""The device that computes blocks: the processor or CUDA, and its support of bfloat16."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

import torch

from matcap.errors import UsageError

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
