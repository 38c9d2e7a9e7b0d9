"""Why a capture is not better, where the photograph itself shows it, and what helps against it.

A cause is named on evidence of its own (signs.py); where there is none, none is named.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from matcap.capture.verdict.signs import Signs


@dataclass(frozen=True)
class CauseLimits:
    """From where on a sign is one; docs/notes/verdict.md."""

    side: float = 0.3
    """Log: so much brighter a side counts as twice what a flash never does."""
    even: float = 0.1
    """Log: up to so much brighter, no side differs from the middle."""
    room: float = 0.25
    curve: float = 0.12
    streak: float = 1.35
    channels: float = 0.04
    tilt: float = 25.0
    """See Signs."""
    variety: float = 0.2
    """Up to it what is drawn hangs together over much of the photograph."""


CAUSES = CauseLimits()
DARK = (
    "photograph in a dark room, with other lights off, or take one more without flash and give "
    "them with --together"
)


@dataclass(frozen=True)
class Cause:
    """One cause that shows."""

    name: str
    """Of it."""
    strength: float
    """The sign over its limit; at least 1."""
    says: str
    """What it is."""
    remedy: str
    """What helps."""
    explains: frozenset[str]
    """Names of the checks that suffer from it."""


_LIGHT = frozenset({"light", "colour", "piece", "highlight", "flash", "camera"})
_DRAWING = frozenset({"texture", "contrast", "order", "light"})
_RELIEF = frozenset({"texture", "contrast", "piece", "seen"})
_CLIPPED = frozenset({"clipping", "colour", "highlight", "seen", "piece", "contrast", "light"})


def more_photographs(given: int) -> str:
    """What to photograph where so many did not tell enough."""
    if given < 2:
        return "take five photographs and give them with --together, which tells more than one can"
    if given < 5:
        return f"add photographs from other sides to these {given}: five tell more"
    return "photograph again with the phone moved further to each side (see matcap inspect)"


def causes(signs: Signs) -> tuple[Cause, ...]:
    """All that show, the strongest first."""
    found = [cause for cause in _all(signs) if cause.strength >= 1.0]
    return tuple(sorted(found, key=lambda cause: -cause.strength))


def _all(signs: Signs) -> Iterator[Cause]:
    yield Cause(
        "anisotropic highlight",
        (signs.streak - 1.0) / (CAUSES.streak - 1.0),
        f"the highlight is a streak, {signs.streak:.1f} times as long as a round one would be: "
        "gloss depends on direction, which the maps cannot tell",
        "shade it as anisotropic where you use it",
        frozenset({"highlight", "light", "piece"}),
    )
    even = 0.0 <= signs.side <= CAUSES.even
    yield Cause(
        "no flash",
        1.0 if even and not signs.fired else 0.0,
        "no flash shows: a side is as bright as the middle",
        "photograph again with the flash on, in a dark room",
        _LIGHT,
    )
    yield Cause(
        "light from a side",
        0.0 if even else 1.0 + signs.side / CAUSES.side,
        f"one side is {math.exp(signs.side):.1f} times as bright as the middle",
        DARK,
        _LIGHT,
    )
    bent = signs.developed and signs.curve / CAUSES.curve >= signs.room / CAUSES.room
    yield Cause(
        "room light",
        0.0 if bent else signs.room / CAUSES.room,
        f"{100.0 * min(signs.room, 1.0):.0f} % of the light in the dark parts is not the flash's",
        DARK,
        _LIGHT,
    )
    yield Cause(
        "tone curve",
        signs.curve / CAUSES.curve if bent else 0.0,
        "the camera bent brightness: bright and dark parts differ otherwise than light does",
        "take RAW (DNG)",
        _LIGHT,
    )
    yield Cause(
        "clipping by channel",
        signs.channels / CAUSES.channels,
        f"single channels are clipped on {100.0 * signs.channels:.0f} % of the photograph",
        "photograph again a stop darker",
        _CLIPPED,
    )
    yield Cause(
        "steep relief",
        signs.tilt / CAUSES.tilt,
        f"relief leans by {signs.tilt:.0f} degrees on the mean, which one flash hardly tells",
        more_photographs(signs.photographs),
        _RELIEF,
    )
    yield Cause(
        "large drawing",
        (1.0 - signs.variety) / (1.0 - CAUSES.variety),
        "what is drawn hangs together over much of the photograph",
        "use it with --variety 0, or photograph more of it from further away",
        _DRAWING,
    )
