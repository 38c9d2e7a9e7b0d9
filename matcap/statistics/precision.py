"""Support of bfloat16 on this processor, and on other devices."""

from __future__ import annotations

import torch


def computes_bfloat16() -> bool:
    """Whether the processor has bfloat16 instructions; emulated ones are slower than float32."""
    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())


def multiplies_bfloat16(device: torch.device) -> bool:
    """Whether a device has bfloat16 instructions; emulated ones are slower than float32."""
    if device.type == "cpu":
        if not torch.backends.mkldnn.is_available():
            return False
        return bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())
    return device.type == "cuda" and torch.cuda.is_bf16_supported(including_emulation=False)
