"""Training's precision: bfloat16 where the device multiplies it."""

from __future__ import annotations

import torch

from matcap.statistics.precision import computes_bfloat16


def mixed(device: str) -> torch.autocast:
    """A context in which networks and features are computed in bfloat16 on a device.

    A processor that has to emulate bfloat16 computes in float32, in a third of the time.
    """
    kind = torch.device(device).type
    return torch.autocast(kind, torch.bfloat16, enabled=kind != "cpu" or computes_bfloat16())
