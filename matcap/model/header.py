"""What a `.matcap` file says of itself, and the exemplar in it; without PyTorch.

Read next: material.py, which reads the rest.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open

from matcap.errors import MatcapError
from matcap.files.digest import is_whole
from matcap.model.example.example import Example

FORMAT = "matcap-material"
VERSIONS = (1, 2)  # of the file: without, and with structured noise
REMEDY = "capture the photograph again, or fetch the file again"
# What reading JSON raises that is not as it should be.
DAMAGED = (
    KeyError,
    IndexError,
    TypeError,
    ValueError,
    AttributeError,
    OverflowError,
    RecursionError,
)
EXAMPLE = "example."  # what the names of its tensors begin with
_NAMED = re.compile(r"[^\w .,()+-]+")


@dataclass(frozen=True)
class Exemplified:
    """A material's exemplar with what is told of it.

    Attributes:
        name: of the material.
        provenance: how it was made; JSON.
        example: its exemplar, indexed.
    """

    name: str
    provenance: dict[str, Any]
    example: Example


def read_exemplified(path: Path) -> Exemplified | None:
    """The exemplar of a `.matcap` file, or None where it has none.

    Raises:
        MatcapError: missing, not a material, of another version, or damaged.
    """
    with opened(path, "np") as (file, about):
        example = read_example(about, file.get_tensor)
        if example is None:
            return None
        return Exemplified(plain_name(str(about["name"])), dict(about["provenance"]), example)


def read_example(
    about: Mapping[str, Any], tensor: Callable[[str], NDArray[np.uint8]]
) -> Example | None:
    """The exemplar that a material's description states, if it states one.

    Args:
        about: the description of the material.
        tensor: gives the bytes of a tensor, by its name in the file.

    Raises:
        SafetensorError, and what DAMAGED names: it is not as it should be.
    """
    if "example" not in about:
        return None

    def data(name: str) -> NDArray[np.uint8]:
        found = np.asarray(tensor(EXAMPLE + name))
        if found.dtype != np.uint8 or found.ndim != 1:
            raise ValueError(f"{name} is no bytes")
        return found

    return Example.read(about["example"], data)


@contextmanager
def opened(path: Path, framework: str) -> Iterator[tuple[Any, dict[str, Any]]]:
    """A material's file and its description; what is wrong with either becomes a MatcapError.

    Args:
        path: of the file.
        framework: what tensors are read for: "pt" or "np".

    Raises:
        MatcapError: missing, not a material, of another version, or damaged.
    """
    if not path.is_file():
        what = "this is a folder" if path.is_dir() else "there is no such file"
        raise MatcapError(what, where=str(path), remedy="give a .matcap file")
    try:
        with safe_open(path, framework=framework) as file:
            about = _about(file.metadata(), path)
            if not is_whole(path, file.metadata()):
                raise MatcapError(
                    "the file is damaged: its digest is another than when it was written",
                    where=str(path),
                    remedy=REMEDY,
                )
            yield file, about
    except (SafetensorError, OSError) as error:
        raise MatcapError(
            f"this is not a material, or it is damaged ({error})",
            where=str(path),
            remedy=REMEDY,
        ) from error
    except DAMAGED as error:
        raise MatcapError(
            f"the material's description is damaged ({error})",
            where=str(path),
            remedy=REMEDY,
        ) from error


def plain_name(name: str) -> str:
    """The name as one that may be a file's: nothing of it leads to another folder."""
    return _NAMED.sub("_", name)[:100].strip(" .") or "material"


def _about(metadata: Mapping[str, str] | None, path: Path) -> dict[str, Any]:
    if not metadata or "matcap" not in metadata:
        raise MatcapError(
            "this safetensors file is not a matcap material",
            where=str(path),
            remedy="give a .matcap file written by matcap capture",
        )
    about: dict[str, Any] = json.loads(metadata["matcap"])
    if about["format"] != FORMAT:
        raise MatcapError(
            f"this holds a {about['format']}, not a material",
            where=str(path),
            remedy="give a .matcap file written by matcap capture",
        )
    if about["version"] not in VERSIONS:
        raise MatcapError(
            f"this material is of version {about['version']}; "
            f"this matcap reads {VERSIONS[0]} to {VERSIONS[-1]}",
            where=str(path),
            remedy="install the matcap that wrote it, or capture the photograph again",
        )
    return about
