"""Digest check of safetensors files, without PyTorch.

Read next: tensors.py, which writes the digest.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

DIGEST, METHOD = "digest", "sha256"  # the metadata's entry, and what it is
_AT_ONCE = 1 << 18  # bytes: what stays in a processor's caches


def text_first(metadata: Mapping[str, str]) -> bytes:
    """The metadata, as a digest begins with it."""
    entries = sorted((name, text) for name, text in metadata.items() if name != DIGEST)
    return "\0".join(part for entry in entries for part in entry).encode()


def is_whole(path: Path, metadata: Mapping[str, str]) -> bool:
    """Whether a file's content has the digest that its metadata state; False where they state none.

    Args:
        path: of a safetensors file that could be opened.
        metadata: of it.

    Raises:
        OSError: it cannot be read.
    """
    if DIGEST not in metadata:
        return False
    digest = hashlib.new(METHOD, text_first(metadata))
    with path.open("rb", buffering=0) as file:
        file.seek(int.from_bytes(file.read(8), "little"), 1)
        some = memoryview(bytearray(_AT_ONCE))
        while count := file.readinto(some):
            digest.update(some[:count])
    return digest.hexdigest() == metadata[DIGEST]
