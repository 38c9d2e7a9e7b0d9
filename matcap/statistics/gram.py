"""Gram matrices of features (Gatys et al. 2015; paper, equation 3)."""

from __future__ import annotations

import torch
from torch import Tensor


def gram(features: Tensor) -> Tensor:
    """(B, C, C) second moments of features (B, C, H, W), averaged over the texels, float32."""
    flat = features.flatten(2)
    return (torch.bmm(flat, flat.transpose(1, 2)) / flat.shape[-1]).float()
