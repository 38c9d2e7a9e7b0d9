"""Reads the exemplar of a `.matcap` file, without PyTorch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.example.example import Example
from matcap.field.header import opened


@dataclass(frozen=True)
class Exemplified:
    """A material's exemplar with its name and provenance."""

    name: str
    """Name of the material."""
    provenance: dict[str, Any]
    """Record of how it was made; JSON."""
    example: Example
    """The indexed exemplar."""


def read_exemplified(path: Path, entry: str = "example") -> Exemplified | None:
    """Read the exemplar of a `.matcap` file, or None if it has none.

    Args:
        path: of the file.
        entry: "example", or "drawing" for the exemplar that a decoder draws from.

    Raises:
        MatcapError: missing, not a material, of another version, or damaged.
    """
    with opened(path, "np") as (file, about):
        if entry not in about:
            return None
        example = example_of(about, file, entry)
        return Exemplified(about["name"], about["provenance"], example)


def read(about: Mapping[str, Any], file: Any, path: Path) -> Example | None:  # noqa: ANN401
    """Read the exemplar of an opened material's file, or None if it has none.

    Args:
        about: the file's JSON description.
        file: opened for NumPy or for PyTorch.
        path: of the file.

    Raises:
        SafetensorError, DAMAGED (field/header.py): the data are missing or malformed.
    """
    return example_of(about, file) if "example" in about else None


def example_of(about: Mapping[str, Any], file: Any, entry: str = "example") -> Example:  # noqa: ANN401
    """The example of an entry of the description. Raises as read(), and KeyError without it."""

    def data(name: str) -> NDArray[np.uint8]:
        array = np.asarray(file.get_tensor(f"{entry}.{name}"))
        if array.dtype != np.uint8 or array.ndim != 1:
            raise ValueError(f"{name} is no bytes")
        return array

    return Example.read(about[entry], data)
