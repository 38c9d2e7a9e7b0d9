"""The plan of a picture: which effects run, and the bound on what leaving each out could change."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from matcap.files.srgb import srgb_encode, srgb_slope
from matcap.relight.scene import Film
from matcap.relight.vectors import Array


@dataclass(frozen=True)
class Step:
    """One effect's entry in the plan."""

    effect: str
    """Name of the effect."""
    on: bool
    """Whether it runs."""
    bound: float
    """Largest change of radiance, in any channel of any pixel, from leaving it out."""
    reason: str
    """Why it runs or not."""
    milliseconds: float = 0.0
    """Time it took, summed over cores; 0 before rendering."""
    spends: bool = True
    """Whether, when off, its bound counts against the tolerance: not where the user switched it."""
    share: float | None = None
    """Share of the picture's tiles in which it ran, in [0, 1]; None before rendering."""


@dataclass(frozen=True)
class Plan:
    """All effects, and the tolerance in radiance within which some are left out."""

    steps: tuple[Step, ...]
    tolerance: float
    running: frozenset[str] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "running", frozenset(s.effect for s in self.steps if s.on))

    def on(self, effect: str) -> bool:
        """Whether an effect runs."""
        return effect in self.running

    def left(self, tolerance: float, film: Film) -> float:
        """Remaining tolerance, in code values, after the effects left out by their bounds.

        Effects that the user switched off count nothing.
        """
        spent = sum(step.bound for step in self.steps if not step.on and step.spends)
        light = np.array(min(spent, self.tolerance) * film.gain)
        code = light if film.transfer == "linear" else srgb_encode(light)
        return max(tolerance - float(code), 0.0)

    def done(self, seconds: Mapping[str, float], shares: Mapping[str, float]) -> Plan:
        """The plan with measured seconds, and the share of tiles in which each effect ran."""
        steps = tuple(
            replace(
                step,
                milliseconds=1e3 * seconds.get(step.effect, 0.0),
                share=shares.get(step.effect, 0.0) if step.on else 0.0,
            )
            for step in self.steps
        )
        return Plan(steps, self.tolerance)

    def table(self) -> str:
        """The plan as text: effect, on or off, share of tiles, bound, milliseconds, reason."""
        lines = [f"{'effect':<16}{'':<5}{'tiles':>6}{'bound':>9}{'ms':>10}  reason"]
        for step in self.steps:
            state = "on" if step.on else "off"
            share = "-" if step.share is None else f"{100.0 * step.share:.0f} %"
            lines.append(
                f"{step.effect:<16}{state:<5}{share:>6}{step.bound:>9.2g}"
                f"{step.milliseconds:>10.1f}  {step.reason}"
            )
        lines.append(f"tolerance {self.tolerance:.2g} in radiance; milliseconds of all cores")
        return "\n".join(lines)

    def rows(self) -> list[dict[str, Any]]:
        """One dictionary a step, for JSON; infinite bounds are None."""
        return [
            {
                "effect": step.effect,
                "on": step.on,
                "bound": step.bound if math.isfinite(step.bound) else None,
                "reason": step.reason,
                "tiles": step.share,
                "milliseconds": round(step.milliseconds, 3),
            }
            for step in self.steps
        ]


# Shares of the budget. That of area lights is the measured error of their quadrature. Hardly a
# pixel mirrors so little of an environment that a larger share would let it leave that out.
SHARES: Mapping[str, float] = {"area": 0.4, "environment": 0.05, "interreflection": 0.55}


@dataclass(frozen=True)
class Budget:
    """Error that each pixel may have: the tolerance that the plan has left, in code values.

    Radiance only adds up, so the radiance L of a pixel so far is a lower bound of the final one.
    The sRGB curve f is concave: a change d anywhere above L changes the code by no more than
    f'(L) d. A pixel may thus lose tolerance / f'(L), eight times as much at code 0.5 as at black.
    """

    codes: float
    """Tolerance left, in code values, [0, 1]."""
    film: Film
    """Exposure and transfer of the picture."""
    running: frozenset[str]
    """Names of the effects that run."""

    def radiance(self, effect: str, known: Array) -> Array:
        """(3, ...) radiance that leaving an effect out may change.

        Args:
            effect: a name in SHARES.
            known: (3, ...) radiance of the pixels so far.
        """
        share = SHARES[effect] / sum(SHARES[one] for one in {effect, *self.running} & set(SHARES))
        allowed = np.float32(share * self.codes / self.film.gain)
        if self.film.transfer == "linear":
            return np.broadcast_to(allowed, known.shape)
        return allowed / srgb_slope(known * np.float32(self.film.gain))
