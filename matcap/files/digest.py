"""Digest check of safetensors files, without PyTorch.

Read next: tensors.py, which writes the digest.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

DIGEST, METHOD = "digest", "sha256"  # name of the metadata's entry, and the hash function
_AT_ONCE = 1 << 18  # bytes read at once, which fit a processor's caches


def digest_prefix(metadata: Mapping[str, str]) -> bytes:
    """The metadata's bytes, which the digest covers before the tensors' bytes."""
    entries = sorted((name, text) for name, text in metadata.items() if name != DIGEST)
    return "\0".join(part for entry in entries for part in entry).encode()


def digest_matches(path: Path, metadata: Mapping[str, str]) -> bool:
    """Whether a valid safetensors file has the digest in its metadata; False if there is none.

    Raises:
        OSError: the file cannot be read.
    """
    if DIGEST not in metadata:
        return False
    digest = hashlib.new(METHOD, digest_prefix(metadata))
    with path.open("rb", buffering=0) as file:
        file.seek(int.from_bytes(file.read(8), "little"), 1)
        some = memoryview(bytearray(_AT_ONCE))
        while count := file.readinto(some):
            digest.update(some[:count])
    return digest.hexdigest() == metadata[DIGEST]
