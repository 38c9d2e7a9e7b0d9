"""Where blocks are computed: on the processor, or on a CUDA device.

The two round differently, by about 1e-6: what is begun on one is not gone on with on the other
(request.py), and a field stays where it was made.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

import torch

from matcap.errors import UsageError

DeviceName = Literal["auto", "cpu", "cuda"]

_ALONE = threading.Lock()


def find_device(name: DeviceName) -> torch.device:
    """The device of a name; "auto" is CUDA where torch sees such a device, else the processor.

    Of several CUDA devices it is torch's current one; CUDA_VISIBLE_DEVICES chooses another.

    Raises:
        UsageError: CUDA was asked for and torch sees no such device.
    """
    there = torch.cuda.is_available()
    if name == "cuda" and not there:
        raise UsageError(
            "PyTorch sees no CUDA device",
            where="--device",
            remedy="use cpu, or install a CUDA driver and a PyTorch built for it",
        )
    return torch.device("cuda" if there and name != "cpu" else "cpu")


@contextmanager
def repeatable(device: torch.device) -> Iterator[None]:
    """Within, convolutions on CUDA are true float32 ones and the same bits every time.

    As it comes, cuDNN rounds float32 to the ten bits of TF32, and may choose among algorithms by
    how fast they happened to be. These are settings of the whole process, hence one thread at a
    time; a device has no use for more. On the processor nothing happens.
    """
    if device.type != "cuda":
        yield
        return
    settings: Any = torch.backends.cudnn
    with _ALONE:
        before = settings.conv.fp32_precision, settings.deterministic, settings.benchmark
        try:
            # Not `allow_tf32`: it does not hold where torch.backends.fp32_precision says TF32.
            settings.conv.fp32_precision = "ieee"
            settings.deterministic, settings.benchmark = True, False
            yield
        finally:
            settings.conv.fp32_precision, settings.deterministic, settings.benchmark = before
