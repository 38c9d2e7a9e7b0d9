"""Tensors in a safetensors file, written whole or not at all, with a digest of all of it.

A flipped byte in a tensor is another number, which nobody would see: the metadata's entry `digest`
tells. It is of everything but itself, the other metadata and all tensors' bytes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

import torch
from safetensors.torch import save
from torch import Tensor

from matcap.errors import MatcapError
from matcap.files.digest import DIGEST, METHOD, text_first
from matcap.files.staging import staged_file


def write_tensors(path: Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> None:
    """Write tensors by name, and text beside them.

    Args:
        path: of the file; its folder is made when missing.
        tensors: of any shapes, types and devices.
        metadata: strings by name, other than "digest".

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
    plain = save(together)
    start = 8 + int.from_bytes(plain[:8], "little")
    content = memoryview(plain)[start:]
    digest = hashlib.new(METHOD, text_first(metadata))
    digest.update(content)
    # By hand, for safetensors writes the metadata in another order every time.
    told = dict(sorted({**metadata, DIGEST: digest.hexdigest()}.items()))
    header = json.dumps({"__metadata__": told, **json.loads(plain[8:start])}, separators=(",", ":"))
    header += " " * (-len(header) % 8)
    # As bytes: save_file would give the file to its owner alone, whatever the umask says.
    with staged_file(path) as file, file.open("wb") as opened:
        opened.write(len(header).to_bytes(8, "little") + header.encode())
        opened.write(content)
