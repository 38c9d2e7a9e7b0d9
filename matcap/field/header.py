"""The header of a `.matcap` file, read without PyTorch.

Read next: material.py, and the generators' own readers (GENERATORS there).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open

from matcap.brdf.stated import known_provenance
from matcap.errors import MatcapError
from matcap.files.names import digest_matches, sanitised_name
from matcap.files.settings import bounded

FORMAT = "matcap-material"
VERSION, VERSIONS = 5, (5, 6)  # of the file; 6 has two generators
REMEDY = "capture the photograph again, or fetch the file again"
# Exceptions that reading malformed JSON values can raise.
DAMAGED = (LookupError, TypeError, ValueError, AttributeError, OverflowError, RecursionError)


@contextmanager
def opened(path: Path, framework: str) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Open a material's file; yield the safetensors handle and the description.

    Errors raised inside the context that mean damaged data become a MatcapError.

    Args:
        framework: of the tensors that the handle returns, "pt" or "np".

    Raises:
        MatcapError: missing, not a material, of another version, or damaged.
    """
    if not path.is_file():
        what = "this is a folder" if path.is_dir() else "there is no such file"
        what = "this is no ordinary file" if path.exists() and not path.is_dir() else what
        raise MatcapError.at(path, what, "give a .matcap file")
    try:
        with safe_open(path, framework=framework) as file:
            about = _about(file.metadata(), path)
            if not digest_matches(path, file.metadata()):
                what = "the file is damaged: its content does not match its digest"
                raise MatcapError.at(path, what, REMEDY)
            yield file, about
    except (SafetensorError, OSError) as error:
        raise MatcapError.at(path, "this is not a material, or it is damaged", REMEDY) from error
    except DAMAGED as error:
        raise MatcapError.at(
            path, f"the material's description is damaged ({error})", REMEDY
        ) from error


def _about(metadata: Mapping[str, str] | None, path: Path) -> dict[str, Any]:
    remedy = "give a .matcap file written by matcap capture"
    if not metadata or "matcap" not in metadata:
        raise MatcapError.at(path, "this safetensors file is not a matcap material", remedy)
    about: dict[str, Any] = json.loads(metadata["matcap"])
    if about["format"] != FORMAT:
        raise MatcapError.at(path, f"this holds a {about['format']}, not a material", remedy)
    if about["version"] not in VERSIONS:
        known = " and ".join(map(str, VERSIONS))
        raise MatcapError.at(
            path,
            f"this material is of version {about['version']}; this matcap reads {known}",
            "capture the photograph again, or install the matcap that wrote it",
        )
    return _checked(about)


def _checked(about: dict[str, Any]) -> dict[str, Any]:
    """Convert and check the entries that every material has.

    Raises:
        DAMAGED: an entry is missing, of a wrong type or out of range.
    """
    if about.get("generator", "example") not in ("example", "decoder"):
        raise ValueError("its generator is neither example nor decoder")
    return about | {
        "name": sanitised_name(str(about["name"])),
        "texel_size": bounded(about["texel_size"], "texel_size", 1e-9, 1e3),
        "setup": stated_setup(about["setup"]),
        "provenance": known_provenance(about["provenance"]),
    }


def stated_setup(stated: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of FlashSetup from a file's JSON.

    Raises:
        DAMAGED: an entry is missing, of a wrong type or out of range.
    """

    def several(key: str, count: int, least: float, most: float) -> tuple[float, ...]:
        values = stated[key]
        if not isinstance(values, list | tuple) or len(values) != count:
            raise ValueError(f"{key} is not {count} numbers")
        return tuple(bounded(value, key, least, most) for value in values)

    return {
        "fov": bounded(stated["fov"], "fov", 1.0, 170.0),
        "offset": several("offset", 3, -1e3, 1e3),
        "tilt": several("tilt", 2, -1.5, 1.5),
        "intensity": several("intensity", 3, 0.0, 1e12),
        "vignetting": bounded(stated["vignetting"], "vignetting", -20.0, 20.0),
        "vignetting_quartic": bounded(
            stated["vignetting_quartic"], "vignetting_quartic", -20.0, 20.0
        ),
        **{
            key: several(key, count, -10.0, 10.0)
            for key, count in (("vignetting_centre", 2), ("vignetting_colour", 3))
            if key in stated
        },
        "turned": stated.get("turned", False) is True,
    }
