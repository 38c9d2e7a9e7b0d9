"""Support of bfloat16 on this processor."""

from __future__ import annotations

import torch


def computes_bfloat16() -> bool:
    """Whether the processor computes with bfloat16; where it is emulated, float32 is quicker."""
    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())
