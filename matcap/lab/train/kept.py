"""Results that are kept as they are made, so that a long evaluation can be taken up again.

A folder holds results.jsonl, a line a result, and a PNG beside it for each. A result's key is a
hash of everything it follows from but the program: whoever changes that removes the folder.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from matcap.errors import MatcapError
from matcap.files.png import write_png
from matcap.lab.train.measure import Result
from matcap.lab.train.pack import Entry, read_code
from matcap.space.prior.store import Prior

_NUMBERS = tuple(f.name for f in fields(Result) if f.name != "picture")


def once(folder: Path, key: str, make: Callable[[], Result]) -> Result:
    """The result that is kept under a key, or the one made now, which then is kept.

    A result that is only half there, because whatever wrote it was killed, is made again.

    Raises:
        MatcapError: the folder cannot be written.
    """
    found = _find(folder, key)
    if found is None:
        found = make()
        _keep(folder, key, found)
    return found


def key_of(*parts: object) -> str:
    """16 hexadecimal digits that stand for some values; bytes as they are, others as printed."""
    digest = hashlib.sha256()
    for part in parts:
        data = part if isinstance(part, bytes) else repr(part).encode()
        digest.update(len(data).to_bytes(8, "big") + data)
    return digest.hexdigest()[:16]


def photograph_key(entry: Entry) -> str:
    """Stands for a photograph and what is known of it."""
    return key_of(entry.material, entry.jpeg, entry.coarse, entry.waves)


def prior_key(prior: Prior) -> str:
    """Stands for the networks a capture starts from."""
    states = (prior.encoder.state_dict(), prior.decoder.state_dict())
    tensors = [item for state in states for item in state.items()]
    return key_of(*(part for name, value in tensors for part in (name, _bytes(value))))


def _bytes(tensor: Tensor) -> bytes:
    return tensor.detach().cpu().float().contiguous().numpy().tobytes()


def _find(folder: Path, key: str) -> Result | None:
    table = folder / "results.jsonl"
    if not table.is_file():
        return None
    # The last one first: it was made because those before it lacked something.
    for line in reversed(table.read_text(encoding="utf-8").splitlines()):
        try:
            told = json.loads(line)
            if told["key"] != key:
                continue
            picture = _read_picture(folder / f"{key}.png")
            return Result(**{name: told[name] for name in _NUMBERS}, picture=picture)
        except (ValueError, KeyError, TypeError, OSError, MatcapError):
            continue  # torn, or without its picture
    return None


def _keep(folder: Path, key: str, result: Result) -> None:
    table = folder / "results.jsonl"
    line = json.dumps({"key": key} | {name: getattr(result, name) for name in _NUMBERS})
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # The picture first: a line says that all of its result is there.
        write_png(folder / f"{key}.png", result.picture.permute(1, 2, 0).numpy(), bits=8)
        torn = table.is_file() and not table.read_bytes().endswith(b"\n")
        with table.open("a", encoding="utf-8") as file:
            file.write(("\n" if torn else "") + line + "\n")
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise MatcapError(
            f"the result cannot be kept ({error})",
            where=str(folder),
            remedy="choose a folder that can be written and has room",
        ) from error


def _read_picture(path: Path) -> Tensor:
    """(3, H, W) sRGB in [0, 1]."""
    code = read_code(path.read_bytes(), path.name)[..., ::-1]
    return torch.from_numpy(np.ascontiguousarray(code.transpose(2, 0, 1))).float() / 255.0
