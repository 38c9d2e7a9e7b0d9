"""Reads and writes tensors in safetensors files, atomically, with a digest.

Files may be hostile: nothing in them is executed, and a tensor's shape is checked before it is
read. The metadata's `digest` detects damaged values; it covers all other metadata and all tensors'
bytes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from matcap.errors import MatcapError
from matcap.files.names import DIGEST, METHOD, digest_prefix
from matcap.files.output import Output

Loaded = TypeVar("Loaded", bound=nn.Module)


def write_tensors(path: Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> None:
    """Write tensors and metadata.

    Args:
        metadata: strings by name, other than "digest".

    Raises:
        MatcapError: the folder cannot be written, or the disk is full; a half float has overflowed.
    """
    for name, tensor in tensors.items():
        if tensor.dtype == torch.float16 and not bool(torch.isfinite(tensor).all()):
            raise MatcapError.at(
                path.name,
                f"{name} has values too large for half float (65504), or none at all",
                "train it again, at a lower rate",
            )
    together = {name: tensor.contiguous() for name, tensor in tensors.items()}
    plain = save(together)
    start = 8 + int.from_bytes(plain[:8], "little")
    content = memoryview(plain)[start:]
    digest = hashlib.new(METHOD, digest_prefix(metadata))
    digest.update(content)
    # safetensors would write the metadata in a random order.
    about = dict(sorted({**metadata, DIGEST: digest.hexdigest()}.items()))
    header = json.dumps(
        {"__metadata__": about, **json.loads(plain[8:start])}, separators=(",", ":")
    )
    header += " " * (-len(header) % 8)
    # save_file would ignore the umask.
    with Output.file(path) as file, file.open("wb") as opened:
        opened.write(len(header).to_bytes(8, "little") + header.encode())
        opened.write(content)


@dataclass(frozen=True)
class StoredTensors:
    """An open safetensors file, with the path and the remedy that errors give."""

    file: safe_open
    path: Path
    remedy: str

    def tensor(self, name: str, shape: tuple[int, ...]) -> Tensor:
        """Read a tensor as float32.

        Raises:
            MatcapError: it is missing, of another shape, or not finite; names the tensor.
        """
        try:
            size = tuple(self.file.get_slice(name).get_shape())
        except SafetensorError as error:
            raise self._fault(f"the tensor {name} is missing") from error
        if size != shape:
            raise self._fault(f"the tensor {name} has shape {size}, expected {shape}")
        # A copy, because the rounding of matrix products depends on the alignment of their
        # operands, which in a file is arbitrary.
        value: Tensor = self.file.get_tensor(name).to(torch.float32, copy=True)
        if not bool(torch.isfinite(value).all()):
            raise self._fault(f"the tensor {name} holds NaN or infinity")
        return value

    def load(self, network: Loaded, prefix: str = "") -> Loaded:
        """The network with the file's weights, named with the prefix, without gradients.

        Raises:
            MatcapError: see tensor().
        """
        weights = {
            name: self.tensor(f"{prefix}{name}", tuple(value.shape))
            for name, value in network.state_dict().items()
        }
        network.load_state_dict(weights, assign=True)
        return network.eval().requires_grad_(False)

    def _fault(self, what: str) -> MatcapError:
        return MatcapError.at(self.path, what, self.remedy)
