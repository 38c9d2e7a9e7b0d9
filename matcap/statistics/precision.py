"""Support of bfloat16 on this processor."""

from __future__ import annotations

import torch


def computes_bfloat16() -> bool:
    """Whether the processor has bfloat16 instructions; emulated ones are slower than float32."""
    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())
