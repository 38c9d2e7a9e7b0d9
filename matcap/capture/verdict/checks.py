"""Each measure rated: how bad it is, in words, with the likely cause and what to do.

Severities share one scale: up to 1 nobody minds, up to 2 one sees it beside the photograph, up to
3 one sees it without, and beyond it is another material. Limits are what a person notices, not
what captures reach: docs/notes/verdict.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from matcap.capture.verdict.causes import more_photographs
from matcap.capture.verdict.evidence import Evidence
from matcap.capture.verdict.marks import worst_mark
from matcap.capture.verdict.rating import Rating
from matcap.flash.highlight import HIGHLIGHT, Highlight
from matcap.photo.inspect import SHOT

# Where severities 1, 2 and 3 are reached.
Limits = tuple[float, float, float]


@dataclass(frozen=True)
class VerdictLimits:
    """What a person minds, as three severities' limits or one; docs/notes/verdict.md."""

    widest: float = 0.34
    """Plane units, half width: a highlight plain to see is narrower than the falloff, ..."""
    faintest: float = 2.0
    """... and so much over its surroundings."""
    apart: Limits = (0.03, 0.08, 0.15)
    """Plane units between centres of highlights, and ..."""
    apart_of_width: Limits = (0.1, 0.25, 0.5)
    """... shares of the width more: wide ones have no place."""
    wider: Limits = (math.log(1.3), math.log(1.8), math.log(3.0))
    """Log of widths, either way."""
    brighter: Limits = (math.log(1.3), math.log(1.8), math.log(3.0))
    """Log of peak over surroundings, either way."""
    flash: Limits = (-1.5, -1.25, -SHOT.falloff)
    """Hot spot over border, negative: less is worse."""
    colour: Limits = (0.06, 0.15, 0.35)
    """Log: 6 % is just seen side by side."""
    light: Limits = (0.12, 0.22, 0.4)
    """Log, of what is smooth."""
    texture: Limits = (1.1, 1.5, 2.3)
    """In the photograph's own differences: 1 is a perfect copy."""
    contrast: Limits = (math.log(1.25), math.log(1.6), math.log(2.5))
    """Log, either way."""
    unseen_contrast: float = 0.01
    """Log luminance that the eye does not see in a surface."""
    order: Limits = (0.3, 0.5, 0.75)
    """Share of the likeness a period further that is lost."""
    plain_order: float = 0.15
    """Likeness of a photograph whose order is plain to see."""
    piece: Limits = (0.12, 0.22, 0.4)
    """Log radiance, of the photographed piece's own maps."""
    marks: Limits = (1.0, 2.0, 4.0)
    """Multiples of what is just seen of one (MARK_LIMITS)."""
    guessed: Limits = (0.6, 0.75, 0.9)
    """Mean of what confidence lacks."""
    uneven: Limits = (SHOT.uneven, SHOT.mixed, 4.5)
    """Of parts of the photograph."""
    tilted: Limits = (SHOT.tilted, SHOT.much_tilted, 25.0)
    """Degrees."""
    placed: Limits = (0.25, 0.35, 0.6)
    """Plane units: a flash sits one or two centimetres off."""
    clipped: Limits = (0.02, 0.08, 0.25)
    """Share of the photograph."""


LIMITS = VerdictLimits()

# Of every map, where a mark in it is just seen.
MARK_LIMITS: Mapping[str, float] = {
    "albedo": 0.05,
    "specular": 0.15,
    "roughness": 0.025,
    "grain": 0.3,
}
_MARKED = {
    "albedo": "diffuse differs there by a factor of {:.2f}",
    "specular": "specular differs there by a factor of {:.2f}",
    "roughness": "roughness differs there by {:.2f}",
    "grain": "relief is stronger or weaker there by a factor of {:.2f}",
}

_TRY = "try --preset high"
_SHOOT = "photograph again, squarely from above, in the dark, a stop darker, RAW if you can"


@dataclass(frozen=True)
class QualityCheck:
    """One thing that was looked at."""

    name: str
    """Of it."""
    severity: float
    """0 nothing, up to 1 good, 2 usable, 3 doubtful, beyond failed."""
    says: str
    """What was found."""
    cause: str = ""
    """What it comes from where the measure itself says so; causes.py has the others."""
    remedy: str = ""
    """What to do, or ""."""

    @property
    def rating(self) -> Rating:
        """Its severity in a word."""
        return Rating.of(self.severity)


def severity(value: float, limits: Limits) -> float:
    """A measure on the common scale, straight between its limits; 0 for what is not known.

    Limits may be negative where less is worse; below the first of them severity falls to 0 within
    the distance to the second.
    """
    first, second, third = limits
    if math.isnan(value):
        return 0.0
    if value <= first:
        start = 0.0 if first > 0.0 else 2.0 * first - second
        return max(0.0, (value - start) / (first - start))
    if value <= second:
        return 1.0 + (value - first) / (second - first)
    return 2.0 + (value - second) / (third - second)


def all_checks(seen: Evidence) -> Iterator[QualityCheck]:
    """Everything that can be rated, in the order in which a person would look."""
    yield _flash(seen)
    yield _highlight(seen)
    yield _light(seen)
    yield _colour(seen)
    yield _texture(seen)
    yield _contrast(seen)
    yield from _order(seen)
    yield from _piece(seen)
    yield from _marks(seen)
    yield _sameness(seen)
    yield _camera(seen)
    yield _clipping(seen)


def _flash(seen: Evidence) -> QualityCheck:
    rated = severity(-seen.flash_ratio, LIMITS.flash)
    # Files err, and a matt material under a flash far away has little falloff; both together tell.
    rated += 1.5 * (seen.flash_fired is False)
    rated -= 0.5 * (seen.flash_fired is True)
    says = f"the photograph's middle is {seen.flash_ratio:.1f} times as bright as its border"
    if seen.flash_fired is False:
        says += ", and the file says that the flash did not fire"
    return QualityCheck(
        "flash", rated, says, "no flash, or other light", "photograph again with the flash on"
    )


def plain(highlight: Highlight | None) -> bool:
    """Whether a highlight is plain to see."""
    return (
        highlight is not None
        and highlight.width < LIMITS.widest
        and highlight.contrast > LIMITS.faintest
    )


def _highlight(seen: Evidence) -> QualityCheck:
    before, after = seen.highlights
    remedy = f"{_TRY}, give --fov if you know it, or {_SHOOT}"
    if not plain(before) and not plain(after):
        return QualityCheck("highlight", 0.0, "no highlight is plain to see in either")
    if after is None:
        return QualityCheck(
            "highlight",
            # A strong one that is lost is another material; one just plain to see is missed.
            severity(math.log(before.contrast / HIGHLIGHT.faintest), LIMITS.brighter)
            if before is not None
            else 0.0,
            "the photograph's highlight is lost",
            "",
            remedy,
        )
    own = LIMITS.faintest if before is None else before.contrast
    more = severity(math.log(after.contrast / own), LIMITS.brighter)
    # Between a highlight that is just plain to see and one that just is not there is no step.
    new = 0.0 if plain(before) else 1.0 if before is None else min(more, 1.0)
    worst, says, cause = _unlike(before, after) if before is not None else (more, "", "")
    if new == 1.0:
        says = "the re-rendering has a highlight that the photograph has not"
        cause = ""
    return QualityCheck("highlight", worst + new, says, cause, remedy)


def _unlike(before: Highlight, after: Highlight) -> tuple[float, str, str]:
    """What differs most between two highlights: its severity, what is seen, the likely cause."""
    apart = math.dist(before.centre, after.centre)
    first, second, third = (
        limit + share * before.width
        for limit, share in zip(LIMITS.apart, LIMITS.apart_of_width, strict=True)
    )
    wider, brighter = after.width / before.width, after.contrast / before.contrast
    found = (
        (
            severity(apart, (first, second, third)),
            f"the highlight is {50.0 * apart:.0f} % of the picture's long side off",
            "the light's place or the field of view is wrong",
        ),
        (
            severity(abs(math.log(wider)), LIMITS.wider),
            f"the highlight is {wider:.1f} times as wide as in the photograph",
            "",
        ),
        (
            severity(abs(math.log(brighter)), LIMITS.brighter),
            f"the highlight stands out {brighter:.1f} times as much as in the photograph",
            "",
        ),
    )
    return max(found)


def _try_or_more(seen: Evidence) -> str:
    return f"{_TRY}, or {more_photographs(seen.signs.photographs)}"


def _light(seen: Evidence) -> QualityCheck:
    return QualityCheck(
        "light",
        severity(seen.light, LIMITS.light),
        f"brightness is distributed otherwise than in the photograph, by {_percent(seen.light)}",
        "",
        more_photographs(seen.signs.photographs),
    )


def _colour(seen: Evidence) -> QualityCheck:
    worst = max(map(abs, seen.colour))
    return QualityCheck(
        "colour",
        severity(worst, LIMITS.colour),
        f"colours are off by {_percent(worst)}",
        "",
        _try_or_more(seen),
    )


def _texture(seen: Evidence) -> QualityCheck:
    return QualityCheck(
        "texture",
        severity(seen.likeness, LIMITS.texture),
        f"the texture differs from the photograph's by {seen.likeness:.1f} times what the "
        "photograph's own parts differ by"
        if math.isfinite(seen.likeness)
        else "the picture is too small to compare textures",
        "",
        _try_or_more(seen),
    )


def _contrast(seen: Evidence) -> QualityCheck:
    changes = {
        band: math.log((after + LIMITS.unseen_contrast) / (before + LIMITS.unseen_contrast))
        for band, (before, after) in seen.contrast.items()
    }
    band = max(changes, key=lambda name: abs(changes[name]))
    more = "stronger" if changes[band] > 0.0 else "weaker"
    return QualityCheck(
        "contrast",
        severity(abs(changes[band]), LIMITS.contrast),
        f"{band} is {math.exp(abs(changes[band])):.1f} times {more} than in the photograph",
        "",
        _try_or_more(seen),
    )


def _order(seen: Evidence) -> Iterator[QualityCheck]:
    if seen.order is None:
        return
    before, after = seen.order
    if before < LIMITS.plain_order:
        yield QualityCheck("order", 0.0, "the regular order is too faint to be seen")
        return
    kept = max(after, 0.0) / before
    yield QualityCheck(
        "order",
        severity(1.0 - kept, LIMITS.order),
        f"{100.0 * min(kept, 1.0):.0f} % of the photograph's regular order is kept",
        "the pattern's period was not found exactly, or it bends",
        f"{_TRY}, or photograph it flat and from nearer",
    )


def _piece(seen: Evidence) -> Iterator[QualityCheck]:
    if seen.piece is None:
        return
    error = seen.piece["error"]
    yield QualityCheck(
        "piece",
        severity(error, LIMITS.piece),
        f"maps of the photographed piece leave {_percent(error)} of its light unexplained",
        "",
        _try_or_more(seen),
    )
    trusted = {name: seen.piece[name] for name in seen.piece if name not in ("error", "slow")}
    least = min(trusted, key=lambda name: trusted[name])
    guessed = 1.0 - sum(trusted.values()) / len(trusted)
    yield QualityCheck(
        "seen",
        severity(guessed, LIMITS.guessed),
        f"{100.0 * guessed:.0f} % of the maps is guessed, most of {least}",
        "clipped, dark or dull parts tell little",
        _SHOOT,
    )


def _marks(seen: Evidence) -> Iterator[QualityCheck]:
    if seen.marks is None:
        return
    name, times = worst_mark(seen.marks, MARK_LIMITS)
    amount = seen.marks[name] if name == "roughness" else math.exp(seen.marks[name])
    yield QualityCheck(
        "marks",
        severity(times, LIMITS.marks),
        f"a mark is left where the flash was: {_MARKED[name].format(amount)}",
        "the highlight was taken for the material's own",
        more_photographs(seen.signs.photographs),
    )


def _sameness(seen: Evidence) -> QualityCheck:
    return QualityCheck(
        "sameness",
        severity(seen.unevenness, LIMITS.uneven),
        "the sample looks the same all over"
        if seen.unevenness < LIMITS.uneven[0]
        else "the sample does not look the same all over",
        "several materials, stains, a picture or shadows",
        "fill the picture with one material",
    )


def _camera(seen: Evidence) -> QualityCheck:
    tilted, placed = severity(seen.tilt, LIMITS.tilted), severity(seen.offset, LIMITS.placed)
    if placed > tilted:
        return QualityCheck(
            "camera",
            placed,
            f"the light seems to be {50.0 * seen.offset:.0f} % of the picture's long side beside "
            "the lens",
            "other light, or a wrong field of view",
            "switch other lights off, and give --fov if you know it",
        )
    return QualityCheck(
        "camera",
        tilted,
        f"the camera was tilted by {seen.tilt:.0f} degrees",
        "it was held askew, or other light came from one side",
        "hold the phone parallel to the sample, with other lights off",
    )


def _clipping(seen: Evidence) -> QualityCheck:
    return QualityCheck(
        "clipping",
        severity(seen.clipped, LIMITS.clipped),
        f"{_percent(seen.clipped)} of the photograph is clipped",
        "it was exposed too long",
        "photograph again a stop darker",
    )


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"
