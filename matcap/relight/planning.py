"""Decide which effects run, from upper bounds on what leaving each out could change.

Effects are left out in the order of their bounds, as long as these add up to no more than the
tolerance; the picture then differs by no more than that from one with all effects. The tolerance is
in code values of the film (default: half an 8-bit step). It becomes a radiance by its value on the
sRGB curve at 0: the curve is concave with f(0) = 0, so |f(a) - f(b)| <= f(|a - b|).
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass

import numpy as np

from matcap.errors import UsageError
from matcap.files.srgb import srgb_decode
from matcap.relight.effects.entries import EFFECTS
from matcap.relight.plan import Plan, Step
from matcap.relight.scene import Film
from matcap.relight.scene_bounds import SceneBounds


@dataclass(frozen=True)
class EffectChoice:
    """The user's choice: a start ("auto", "all" or "none") and effects forced on or off."""

    start: str = "auto"
    forced: tuple[tuple[str, bool], ...] = ()


def parse_choice(text: str) -> EffectChoice:
    """Parse `--effects`: "all", "none", "+x,-y", or both: "none,+diffuse".

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
            raise UsageError.at(
                "--effects",
                f"'{part}' is not an effect to switch",
                f"give all, none, or +{near} or -{near} (of {', '.join(EFFECTS)})",
            )
        forced.append((name, sign == "+"))
    return EffectChoice(start, tuple(forced))


def radiance_tolerance(tolerance: float, film: Film) -> float:
    """Radiance whose code value, after exposure, is the tolerance."""
    if film.transfer == "linear":
        return tolerance / film.gain
    return float(srgb_decode(np.array(tolerance))) / film.gain


def make_plan(limits: SceneBounds, tolerance: float, choice: EffectChoice) -> Plan:
    """Choose the effects that run.

    Args:
        limits: extremes of the scene, from which each effect computes its bound.
        tolerance: largest sum of the bounds of effects left out, in radiance.
        choice: start, and effects that the user forced on or off.
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
