"""Tensors in a safetensors file, written whole or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
from safetensors.torch import save
from torch import Tensor

from matcap.errors import MatcapError
from matcap.files.staging import staged_file


def write_tensors(path: Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> None:
    """Write tensors by name, and text beside them.

    Args:
        path: of the file; its folder is made when missing.
        tensors: of any shapes, types and devices.
        metadata: strings by name.

    Raises:
        MatcapError: the folder cannot be written, or the disk is full; a half float has overflowed.
    """
    for name, tensor in tensors.items():
        if tensor.dtype == torch.float16 and not bool(torch.isfinite(tensor).all()):
            raise MatcapError(
                f"{name} has values too large for half float (65504), or none at all",
                where=path.name,
                remedy="train it again, at a lower rate",
            )
    together = {name: tensor.contiguous() for name, tensor in tensors.items()}
    with staged_file(path) as file:
        # As bytes: save_file would give the file to its owner alone, whatever the umask says.
        file.write_bytes(save(together, dict(metadata)))
