"""What draws from one domain come to."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from time import process_time

import numpy as np
from numpy.typing import ArrayLike, NDArray

from matcap.errors import MatcapError


@dataclass(frozen=True)
class Swept:
    """What was drawn of a domain."""

    draws: int = 0
    """Values looked at."""
    broken: int = 0
    """Values not finite, or calls that ended in anything but a value or a sentence."""
    refused: int = 0
    """Calls that ended in a sentence with a remedy."""
    worst: float = 0.0
    """The largest error; what it is relative to, DOMAINS says."""
    where: str = ""
    """Where the largest error was, in words."""
    worst_smooth: float = 0.0
    """The largest below roughness SMOOTH, where a looser bound holds there."""
    slowest: float = 0.0
    """Processor seconds of the longest call, with its reference."""

    def __add__(self, other: Swept) -> Swept:
        worst = max(self.worst, self.worst_smooth)
        worse = other if max(other.worst, other.worst_smooth) > worst or not self.where else self
        return Swept(
            self.draws + other.draws,
            self.broken + other.broken,
            self.refused + other.refused,
            max(self.worst, other.worst),
            worse.where,
            max(self.worst_smooth, other.worst_smooth),
            max(self.slowest, other.slowest),
        )


# A few thousand values drawn with a generator, and what they came to.
Domain = Callable[[np.random.Generator], Swept]


def sweep(domain: Domain, draws: int, seed: int | list[int]) -> Swept:
    """Call a domain until it has drawn so many values; warnings of NumPy's are bugs, too."""
    generator = np.random.default_rng(seed)
    found = Swept()
    while found.draws < draws:
        start = process_time()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                one = domain(generator)
        except MatcapError as error:
            named = bool(error.what and error.remedy)
            one = Swept(1, broken=not named, refused=named)
        except Exception as error:  # a bug is what this looks for, and the sweep goes on
            what = f"{type(error).__name__}: {error}".splitlines()[0]
            one = Swept(1, broken=1, worst=math.inf, where=what[:200])
        found += replace(one, slowest=process_time() - start)
    return found


def compared(
    values: NDArray[np.floating],
    exact: NDArray[np.floating],
    least: ArrayLike,
    where: Callable[[int], str] | str,
) -> Swept:
    """Values beside exact ones of the same shape.

    Args:
        values: as computed.
        exact: in float64.
        least: errors are relative to the exact value, or to this where it is less.
        where: in words; of the number of a value, counted row by row, if it is a function.
    """
    values, exact = np.broadcast_arrays(values, exact)
    error = np.abs(values - exact) / np.maximum(np.abs(exact), least)
    error = np.where(np.isfinite(values), error, np.inf)
    at = int(error.argmax())
    broken = int((~np.isfinite(values)).sum())
    words = where if isinstance(where, str) else where(at)
    return Swept(values.size, broken, 0, float(error.flat[at]), words)


def log_uniform(
    g: np.random.Generator, low: float, high: float, size: int | tuple[int, ...] | None = None
) -> NDArray[np.float64]:
    """Numbers whose logarithms are uniform."""
    return np.exp(g.uniform(math.log(low), math.log(high), size))
