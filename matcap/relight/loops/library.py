"""The compiled loops, and their C structures field by field."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from matcap.files.process import find_library, not_built
from matcap.relight.camera import Array, lattice

# As in loops.h.
_FORM = 5
LANES, CHANNELS, AZIMUTHS = 8, 9, 16

Pointer, Whole, Real = ctypes.c_void_p, ctypes.c_int32, ctypes.c_float


@cache
def built() -> Any | None:  # noqa: ANN401
    """The library; None where it was not built, or from another version of its sources (_FORM)."""
    return find_library(Path(__file__).parent, ("matcap_relight_form", _FORM))


def loops() -> Any:  # noqa: ANN401
    """The library.

    Raises:
        MatcapError: it was not built from these sources.
    """
    library = built()
    if library is None:
        raise not_built("relighting")
    return library


class KeptArrays:
    """Keeps NumPy arrays alive while C code holds their addresses."""

    def __init__(self) -> None:
        self._arrays: list[Array] = []

    def of(self, values: Array | Sequence[float], dtype: type = np.float32) -> int:
        """Address of values as a C-contiguous array of a dtype; copies only if they are not."""
        array: Array = np.ascontiguousarray(values, dtype=dtype)
        self._arrays.append(array)
        return array.ctypes.data

    def kept_by(self, structure: Holder) -> Holder:
        """The structure, which keeps the arrays alive from now on."""
        structure.kept = self
        return structure


class ArrayStructure(ctypes.Structure):
    """A C structure that points to arrays."""

    kept: KeptArrays
    """Keeps them alive."""


Holder = TypeVar("Holder", bound=ArrayStructure)


def address(array: Array) -> Any:  # noqa: ANN401
    """Pointer to a C-contiguous array that the loops write to."""
    assert array.flags.c_contiguous
    return Pointer(array.ctypes.data)


# C structures of the loops, field by field as in loops.h and the .c files, which explain them.

_Three, _Nine = Pointer * 3, Pointer * 9
_Vector = Real * 3
# Terms that a CLamp adds, as bits (lights.c); VECTOR is vector irradiance.
DIFFUSE, SPECULAR, LOST, VECTOR = 1, 2, 4, 8


class CField(ctypes.Structure):
    """Field: the height field."""

    _fields_ = (
        ("heights", Pointer), ("columns", Whole), ("rows", Whole), ("ends", Whole), ("lift", Real),
        ("high", ctypes.c_double), ("low", ctypes.c_double), ("texel", ctypes.c_double),
        ("clear", Pointer),
    )  # fmt: skip


class CPixels(ArrayStructure):
    """Structure of a block of pixels."""

    _fields_ = (
        ("count", ctypes.c_int64), ("column", Pointer), ("row", Pointer), ("point", _Three),
        ("frame", _Nine), ("height", Pointer), ("view", _Three), ("normal", _Three),
        ("n_dot_v", Pointer), ("alpha", Pointer), ("facing", Pointer), ("wide", Pointer),
        ("diffuse", _Three),
        ("specular", _Three), ("strength", _Three), ("near", Pointer), ("lost", Pointer),
        ("lost_size", Whole), ("lost_step", Real), ("total", _Three), ("vector_irradiance", _Nine),
    )  # fmt: skip


class CLattice(ArrayStructure):
    """Lattice: samples of visible normals."""

    _fields_ = (
        ("u", Pointer), ("cosine", Pointer), ("sine", Pointer), ("weight", Pointer),
        ("points", Whole),
    )  # fmt: skip


class CLamp(ctypes.Structure):
    """Lamp: a point or directional light."""

    _fields_ = (
        ("place", _Vector), ("normal", _Vector), ("colour", _Vector), ("far", Whole),
        ("faces", Whole), ("parts", Whole), ("power", Real), ("even", Real),
    )  # fmt: skip


class CRule(ctypes.Structure):
    """Rule: quadrature points of an area light."""

    _fields_ = (
        ("a", Pointer), ("b", Pointer), ("c", Pointer), ("weight", Pointer), ("cell", Pointer),
        ("nodes", Whole), ("order", Whole),
    )  # fmt: skip


class CAreaLight(ArrayStructure):
    """AreaLight: a sphere or rectangle, and its quadrature rules."""

    _fields_ = (
        ("place", _Vector), ("colour", _Vector), ("normal", _Vector), ("across", _Vector),
        ("along", _Vector), ("size", Real * 2), ("radius", Real), ("half", Real), ("even", Real),
        ("density", Real), ("rate", Real), ("spread", Real), ("turn", Real),
        ("diffuse", Whole), ("specular", Whole), ("limits", Whole * 6),
        ("plain", CRule * 8), ("parted", CRule * 8), ("probe", CRule),
    )  # fmt: skip


class CSearch(ctypes.Structure):
    """Search: step sizes of view rays through the height field."""

    _fields_ = (
        ("peaks", Pointer), ("around", Whole), ("steepest", Real), ("most", Real),
        ("least", Real), ("density", Real),
    )  # fmt: skip


class CTexels(ArrayStructure):
    """Texels: a mip pyramid."""

    _fields_ = (
        ("rows", Pointer), ("starts", Pointer), ("widths", Pointer), ("heights", Pointer),
        ("channels", Whole), ("levels", Whole),
    )  # fmt: skip


class CEnvironment(ArrayStructure):
    """Environment: prefiltered octahedral maps."""

    _fields_ = (
        ("atlas", Pointer), ("tops", Pointer), ("sides", Pointer), ("width", Whole),
        ("levels", Whole), ("finest", Real), ("blur", Real), ("mean", _Vector),
    )  # fmt: skip


class CHorizon(ctypes.Structure):
    """Horizon: horizon maps that directions are compared with."""

    _fields_ = (
        ("tangents", Pointer), ("columns", Whole), ("rows", Whole), ("adaptive", Whole),
    )  # fmt: skip


class CWalk(ArrayStructure):
    """Walk: steps of the horizon maps' computation."""

    _fields_ = (
        *((name, Pointer) for name in (
            "padded", "lit", "cosine", "sine", "offset", "inverse", "end", "nearest",
        )),
        ("steps", Whole), ("parts", Whole), ("columns", Whole), ("reach", Whole),
        ("width", Whole), ("highest", Real),
    )  # fmt: skip


@cache
def directions(samples: int) -> CLattice:
    """A lattice of at least `samples` visible normals, padded to a multiple of LANES."""
    rows, kept = np.array(lattice(samples), dtype=np.float32).T, KeptArrays()
    rows = np.pad(rows, ((0, 0), (0, -rows.shape[1] % LANES)))
    return kept.kept_by(CLattice(*(kept.of(row) for row in rows), rows.shape[1]))
