"""Exemplar: the maps of the photographed rectangle with a confidence per map and texel."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.stated import SPECULAR_CHANNELS, stated_specular
from matcap.files.threads import at_once

# Compressed integer arrays: differences along rows, low bytes before high bytes, deflate.
#
# Of deflate only runs and Huffman codes are used: differences repeat rarely, and the search for
# longer matches takes eight times as long for files that are not smaller.
#
# Decoding checks sizes, as files may be damaged or hostile.


def pack(codes: NDArray[Any]) -> NDArray[np.uint8]:
    """Compress an integer array."""
    swapped = codes.copy()
    swapped[..., 1:] -= codes[..., :-1]
    planes = swapped.astype(swapped.dtype.newbyteorder("<"), copy=False).view(np.uint8)
    planes = planes.reshape(-1, swapped.dtype.itemsize).T
    deflate = zlib.compressobj(strategy=zlib.Z_RLE)
    parts = [deflate.compress(plane.tobytes()) for plane in planes]
    return np.frombuffer(b"".join([*parts, deflate.flush()]), np.uint8)


def unpack(packed: NDArray[np.uint8], shape: tuple[int, ...], kind: type) -> NDArray[Any]:
    """Decompress an array of a shape and type; never allocates more than that needs.

    Raises:
        ValueError: the data are not of this shape and type.
    """
    wanted = np.dtype(kind).newbyteorder("<")
    size = math.prod(shape) * wanted.itemsize
    opened = zlib.decompressobj()
    try:
        data = opened.decompress(packed.tobytes(), size + 1)
    except zlib.error as error:
        raise ValueError(f"bytes that cannot be unpacked ({error})") from error
    if len(data) != size or not opened.eof:
        raise ValueError(f"{len(data)} bytes, expected {size}")
    planes = np.frombuffer(data, np.uint8).reshape(wanted.itemsize, -1).T
    values = np.ascontiguousarray(planes).view(wanted).reshape(shape)
    return np.cumsum(values, axis=-1, dtype=kind)


# NumPy only, so that the field by example needs no PyTorch.
#
# In a file every map is packed 16-bit numbers: half floats, but for height multiples of a power of
# two, as differences of half floats would give uneven slopes. Files may be hostile, so that sizes
# are checked before anything is unpacked.

Floats = NDArray[np.float32]

CHANNELS: dict[str, int] = {"diffuse": 3, "specular": 1, "roughness": 1, "height": 1}
COLOURED = 3  # channels of a specular albedo that has a colour
# Channels of stacked maps, with any number of specular channels.
DIFFUSE, SPECULAR, ROUGHNESS, HEIGHT = slice(0, 3), slice(3, -2), slice(-2, -1), slice(-1, None)
_LARGEST_SIDE = 8192  # texels: more than a photograph of 50 megapixels has
_LARGEST_HEIGHT = 1e6  # plane units
_HEIGHT_STEPS = 2**16 - 1
_CONFIDENCE_STEPS = 15  # confidence is a weight that needs no finer steps


@dataclass(frozen=True)
class Exemplar:
    """Maps of the photographed rectangle, row 0 at the top, float32, each in contiguous memory.

    Raises:
        ValueError: a map of another shape, an empty or too large one, or values out of range.
    """

    diffuse: Floats
    """(3, H, W) diffuse albedo, linear Rec.709, in [0, 1]."""
    specular: Floats
    """(1, H, W) specular albedo F0, in [0, 1]; (3, H, W), linear Rec.709, where it has a colour."""
    roughness: Floats
    """(1, H, W) perceptual roughness in [0, 1]; alpha is its square."""
    height: Floats
    """(1, H, W) in plane units (half the photograph's long side)."""
    confidence: Floats
    """(4, H, W) in [0, 1], of diffuse, specular, roughness and height: 0 where the photograph does
    not determine the map."""
    texel_size: float
    """A texel's side in plane units."""

    def __post_init__(self) -> None:
        rows, columns = self.height.shape[-2:]
        _check_size(columns, rows)
        for name, channels in (*CHANNELS.items(), ("confidence", len(CHANNELS))):
            values = getattr(self, name)
            if name == "specular" and len(values) == COLOURED:
                channels = COLOURED
            if values.shape != (channels, rows, columns) or values.dtype != np.float32:
                raise ValueError(
                    f"{name} is {values.dtype} of shape {values.shape}; expected float32 of "
                    f"({channels}, {rows}, {columns})"
                )
            most = _LARGEST_HEIGHT if name == "height" else 1.0
            least = -most if name == "height" else 0.0
            # Comparisons with NaN are false.
            if not (least <= float(values.min()) and float(values.max()) <= most):
                raise ValueError(f"{name} is not within [{least:g}, {most:g}]")
            # Kernels read planes by their address.
            object.__setattr__(self, name, np.ascontiguousarray(values))
        if not 1e-9 <= self.texel_size <= 1e3:
            raise ValueError(f"a texel size of {self.texel_size}")

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in texels."""
        return self.height.shape[-1], self.height.shape[-2]

    @property
    def coloured(self) -> bool:
        """Whether F0 has three channels."""
        return len(self.specular) == COLOURED

    @staticmethod
    def certain(stacked: Floats, texel_size: float) -> Exemplar:
        """Stacked maps (6 or 8, H, W) that are known everywhere: of confidence 1."""
        diffuse, specular = stacked[DIFFUSE], stacked[SPECULAR]
        known = np.ones((len(CHANNELS), *stacked.shape[1:]), np.float32)
        return Exemplar(diffuse, specular, stacked[ROUGHNESS], stacked[HEIGHT], known, texel_size)

    def cut(self, rows: slice, columns: slice) -> Exemplar:
        """A rectangle of its texels."""
        return self.map(lambda planes: planes[:, rows, columns])

    def turned(self) -> Exemplar:
        """The exemplar rotated by 90 degrees clockwise."""
        return self.map(lambda planes: np.rot90(planes, -1, (1, 2)))

    def map(self, change: Callable[[Floats], Floats]) -> Exemplar:
        """The same exemplar with `change` applied to every map and to the confidence."""
        names = (*CHANNELS, "confidence")
        changed: dict[str, Any] = {name: change(getattr(self, name)) for name in names}
        return replace(self, **changed)

    def stacked(self) -> Floats:
        """(6, H, W): diffuse, specular, roughness, height; 8 where F0 has a colour."""
        return np.concatenate([getattr(self, name) for name in CHANNELS])

    def rounded(self) -> Exemplar:
        """The exemplar with values rounded as in a file; idempotent."""
        unit, low = _height_coding(self.height)
        return replace(
            self,
            diffuse=halves(self.diffuse),
            specular=halves(self.specular),
            roughness=halves(self.roughness),
            height=_height(_height_codes(self.height, unit, low), unit, low),
            confidence=_confidence(_confidence_codes(self.confidence)),
        )

    def stored(self) -> tuple[dict[str, NDArray[np.uint8]], dict[str, Any]]:
        """Tensors (bytes, by map), and a description for JSON; the inverse of read()."""
        unit, low = _height_coding(self.height)
        tensors = {
            name: pack(getattr(self, name).astype(np.float16).view(np.uint16))
            for name in CHANNELS
            if name != "height"
        }
        tensors["height"] = pack(_height_codes(self.height, unit, low))
        tensors["confidence"] = pack(_confidence_codes(self.confidence))
        about: dict[str, Any] = {
            "size": list(self.size),
            "texel_size": self.texel_size,
            "height_unit": math.frexp(unit)[1],
            "height_low": low,
            SPECULAR_CHANNELS: len(self.specular),
        }
        return tensors, about

    @staticmethod
    def read(about: Mapping[str, Any], tensor: Callable[[str], NDArray[np.uint8]]) -> Exemplar:
        """The exemplar of what stored() returned.

        Args:
            tensor: returns the bytes of a map's name.

        Raises:
            ValueError, KeyError, TypeError: an entry or a map is missing or malformed.
        """
        columns, rows = (int(side) for side in about["size"])
        _check_size(columns, rows)
        channels = {**CHANNELS, "specular": stated_specular(about)}
        exponent, low = int(about["height_unit"]), int(about["height_low"])
        if not (-60 <= exponent <= 20 and abs(low) < 2**23):
            raise ValueError(f"heights of {low} and more 2^{exponent}")

        def stated(name: str) -> Floats:
            shape = (channels[name], rows, columns)
            return unpack(tensor(name), shape, np.uint16).view(np.float16).astype(np.float32)

        def heights() -> Floats:
            codes = unpack(tensor("height"), (1, rows, columns), np.uint16)
            return _height(codes, math.ldexp(0.5, exponent), low)

        def confidence() -> Floats:
            shape = len(CHANNELS), rows, columns
            return _confidence(unpack(tensor("confidence"), shape, np.uint8))

        names = ("diffuse", "specular", "roughness")
        tasks: list[Callable[[], Floats]] = [partial(stated, name) for name in names]
        diffuse, specular, roughness, height, known = at_once(*tasks, heights, confidence)
        size = float(about["texel_size"])
        return Exemplar(diffuse, specular, roughness, height, known, size)


def halves(planes: Floats) -> Floats:
    """Values rounded as in a file: of all maps but the height."""
    return planes.astype(np.float16).astype(np.float32)


def _check_size(width: int, height: int) -> None:
    if not (1 <= width <= _LARGEST_SIDE and 1 <= height <= _LARGEST_SIDE):
        raise ValueError(f"an exemplar of {width} x {height} texels")


def _height_coding(height: Floats) -> tuple[float, int]:
    """(unit, low): a power of two in plane units, and the least height in that unit."""
    low, high = float(height.min()), float(height.max())
    # The range must fit 16 bits, less a step for rounding at either end; and multiples of the unit
    # must be exact in float32.
    least = max((high - low) / (_HEIGHT_STEPS - 2), max(abs(low), abs(high)) / 2**22, 2.0**-50)
    unit = 2.0 ** math.ceil(math.log2(least))
    return unit, round(low / unit)


def _height_codes(height: Floats, unit: float, low: int) -> NDArray[np.uint16]:
    # The unit is a power of two, and codes have 23 bits: float32 is exact.
    return (np.rint(height / np.float32(unit)) - np.float32(low)).astype(np.uint16)


def _height(codes: NDArray[np.uint16], unit: float, low: int) -> Floats:
    return (codes.astype(np.float32) + np.float32(low)) * np.float32(unit)


def _confidence_codes(confidence: Floats) -> NDArray[np.uint8]:
    return np.stack([np.rint(one * _CONFIDENCE_STEPS).astype(np.uint8) for one in confidence])


def _confidence(codes: NDArray[np.uint8]) -> Floats:
    return np.divide(codes, np.float32(_CONFIDENCE_STEPS), dtype=np.float32)
