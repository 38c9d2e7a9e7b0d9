"""Tensors in a safetensors file, written whole or not at all, with a digest of all of it.

Files to be read may be a stranger's: nothing in them is executed, and every tensor's shape is
compared with what is expected before it is read.

A flipped byte in a tensor is another number, which would go unnoticed: the metadata's `digest`
detects it. It is of everything but itself, the other metadata and all tensors' bytes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
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
    about = dict(sorted({**metadata, DIGEST: digest.hexdigest()}.items()))
    header = json.dumps(
        {"__metadata__": about, **json.loads(plain[8:start])}, separators=(",", ":")
    )
    header += " " * (-len(header) % 8)
    # As bytes: save_file would give the file to its owner alone, whatever the umask says.
    with staged_file(path) as file, file.open("wb") as opened:
        opened.write(len(header).to_bytes(8, "little") + header.encode())
        opened.write(content)


@dataclass(frozen=True)
class StoredTensors:
    """An open file.

    Attributes:
        file: as safetensors opens it, for PyTorch.
        path: where it is.
        remedy: what to do when it is no good.
    """

    file: safe_open
    path: Path
    remedy: str

    def tensor(self, name: str, shape: tuple[int, ...]) -> Tensor:
        """One tensor as float32.

        Raises:
            MatcapError: it is missing, of another shape, or holds NaN or infinity; names it.
        """
        try:
            size = tuple(self.file.get_slice(name).get_shape())
        except SafetensorError as error:
            raise self._fault(f"the tensor {name} is missing") from error
        if size != shape:
            raise self._fault(f"the tensor {name} has shape {size}, expected {shape}")
        # A copy, because the file's own lie wherever the file has them, and products of matrices
        # round as their operands are aligned: what was saved would differ from itself by a bit.
        value: Tensor = self.file.get_tensor(name).to(torch.float32, copy=True)
        if not bool(torch.isfinite(value).all()):
            raise self._fault(f"the tensor {name} holds NaN or infinity")
        return value

    def _fault(self, what: str) -> MatcapError:
        return MatcapError(what, where=str(self.path), remedy=self.remedy)
