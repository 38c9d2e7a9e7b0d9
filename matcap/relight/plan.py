"""Which effects run: from upper bounds on what leaving each out could change.

An effect is left out only while the bounds of all that are left out add up to no more than the
tolerance, so the picture differs by no more than that from the one with everything. The tolerance
is stated in code values of the film (half an 8-bit step by default): the sRGB curve is concave
and 0 at 0, so two radiances that differ by d have codes that differ by no more than d's own code.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from matcap.errors import UsageError
from matcap.files.srgb import srgb_decode, srgb_encode
from matcap.relight.effects.entries import EFFECTS
from matcap.relight.scene import Film
from matcap.relight.scene_bounds import SceneBounds


@dataclass(frozen=True)
class Step:
    """One effect's place in the plan."""

    effect: str
    """Its name."""
    on: bool
    """Whether it runs."""
    bound: float
    """What leaving it out could change, in radiance."""
    reason: str
    """Why it runs or not."""
    milliseconds: float = 0.0
    """What it took, all cores together; 0 before rendering."""
    spends: bool = True
    """Whether, when off, it is so by its bound and not because it was asked for."""
    share: float | None = None
    """Of the picture's tiles that it ran in; None before rendering."""


@dataclass(frozen=True)
class Plan:
    """The steps, and the tolerance in radiance that they keep to."""

    steps: tuple[Step, ...]
    tolerance: float
    running: frozenset[str] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "running", frozenset(s.effect for s in self.steps if s.on))

    def on(self, effect: str) -> bool:
        """Whether an effect runs."""
        return effect in self.running

    def left(self, tolerance: float, film: Film) -> float:
        """What of a tolerance in code values tiles may still leave out.

        The effects that are off by their bounds have spent the rest; those that were asked for
        off count nothing.
        """
        spent = sum(step.bound for step in self.steps if not step.on and step.spends)
        light = np.array(min(spent, self.tolerance) * film.gain)
        code = light if film.transfer == "linear" else srgb_encode(light)
        return max(tolerance - float(code), 0.0)

    def done(self, seconds: Mapping[str, float], shares: Mapping[str, float]) -> Plan:
        """The plan with what each effect took, and in what share of the tiles it ran."""
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
            lines.append(
                f"{step.effect:<16}{state:<5}{_percent(step.share):>6}{step.bound:>9.2g}"
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


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100.0 * share:.0f} %"


@dataclass(frozen=True)
class EffectChoice:
    """What a user asked for: a start ("auto", "all" or "none") and effects forced on or off."""

    start: str = "auto"
    forced: tuple[tuple[str, bool], ...] = ()


def parse_choice(text: str) -> EffectChoice:
    """The choice that `--effects` means: "all", "none", "+x,-y", or both: "none,+diffuse".

    Raises:
        UsageError: an unknown effect, or one without + or -.
    """
    start, forced = "auto", []
    for index, part in enumerate(part.strip() for part in text.split(",")):
        if index == 0 and part in ("auto", "all", "none"):
            start = part
            continue
        sign, name = part[:1], part[1:]
        if sign not in ("+", "-") or name not in EFFECTS:
            near = difflib.get_close_matches(part.lstrip("+-"), EFFECTS, n=1, cutoff=0.0)[0]
            raise UsageError(
                f"'{part}' is not an effect to switch",
                where="--effects",
                remedy=f"give all, none, or +{near} or -{near} (of {', '.join(EFFECTS)})",
            )
        forced.append((name, sign == "+"))
    return EffectChoice(start, tuple(forced))


def radiance_tolerance(tolerance: float, film: Film) -> float:
    """The change of radiance whose code, after exposure, is the tolerance."""
    if film.transfer == "linear":
        return tolerance / film.gain
    return float(srgb_decode(np.array(tolerance))) / film.gain


def make_plan(limits: SceneBounds, tolerance: float, choice: EffectChoice) -> Plan:
    """Decide what runs.

    Args:
        limits: of the scene.
        tolerance: in radiance.
        choice: of the user.
    """
    bounds = {name: effect.bound(limits) for name, effect in EFFECTS.items()}
    forced = dict(choice.forced)
    off: set[str] = set()
    if choice.start == "none":
        off = set(EFFECTS)
    elif choice.start == "auto":
        left = tolerance
        for effect in sorted(EFFECTS, key=lambda name: bounds[name].radiance):
            if effect in forced:
                continue
            if bounds[effect].radiance > left:
                break
            left -= bounds[effect].radiance
            off.add(effect)
    steps = []
    for effect, bound in bounds.items():
        reason = bound.reason
        if effect in forced:
            reason = f"as asked for ({reason})"
        elif choice.start != "auto":
            reason = f"{choice.start} as asked for ({reason})"
        on = forced.get(effect, effect not in off)
        steps.append(
            Step(
                effect,
                on,
                bound.radiance,
                reason,
                spends=effect in off and effect not in forced and choice.start == "auto",
            )
        )
    return Plan(tuple(steps), tolerance)
