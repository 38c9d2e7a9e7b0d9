"""Tables of the quality checks of photographs, sets and captures, and of causes of poor captures.

A check has limits, messages, a cause and a remedy. Measurements are mapped to one scale of
severity: up to 1 acceptable, up to 2 visible next to the photograph, up to 3 visible without it,
beyond it another material. Limits are of what people notice; their sources are in
docs/notes/verdict.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

Region = tuple[float, float, float, float]
"""Left, top, width and height in shares of the picture's sides, from the upper left."""


class Rating(Enum):
    """Rating of a photograph or a capture."""

    GOOD = "good"
    """No visible difference from the photograph; of a photograph: nothing to improve."""
    USABLE = "usable"
    """Differences are visible only next to the photograph."""
    DOUBTFUL = "doubtful"
    """Differences are visible without it; check before use, or photograph again."""
    FAILED = "failed"
    """Another material than the photographed one; a photograph that would give one."""
    NOT_JUDGED = "not judged"
    """Information without a rating."""

    @staticmethod
    def of(severity: float | None) -> Rating:
        """The rating of a severity: up to 1 good, 2 usable, 3 doubtful, beyond failed."""
        if severity is None:
            return Rating.NOT_JUDGED
        words = (Rating.GOOD, Rating.USABLE, Rating.DOUBTFUL)
        return next((word for most, word in enumerate(words, 1) if severity <= most), Rating.FAILED)

    @property
    def fit(self) -> bool:
        """Whether the rating is neither doubtful nor failed."""
        return self not in (Rating.DOUBTFUL, Rating.FAILED)


@dataclass(frozen=True)
class Finding:
    """Result of one check."""

    name: str
    """A key of CHECKS, or another name."""
    value: Any
    """Measurement as JSON, or None if unknown."""
    rating: Rating
    says: str
    """Result as a clause, or as sentences."""
    remedy: str = ""
    """What to do, as a clause or sentences; or ""."""
    cause: str = ""
    """Likely cause, if the measurement alone determines it; or ""."""
    severity: float = 0.0
    """Severity: up to 1 acceptable, 2 visible, 3 doubtful; 0 if nothing is measured."""
    where: Region | None = None
    """Where it is seen, in the upright picture; None if everywhere or unknown."""

    @property
    def appearance(self) -> str:
        """What a person sees, of a check of a capture; else the finding's own name."""
        return (CHECKS[self.name].seen if self.name in CHECKS else "") or self.name

    def line(self) -> str:
        """Result and remedy as sentences."""
        return f"{sentence(self.says)} {sentence(self.remedy)}".strip()

    def document(self) -> dict[str, Any]:
        """The finding for JSON."""
        return {
            "value": self.value,
            "unit": CHECKS[self.name].unit if self.name in CHECKS else "",
            "rating": self.rating.value,
            "severity": round(self.severity, 3),
            "message": sentence(self.says),
            "cause": self.cause,
            "remedy": sentence(self.remedy),
            "appearance": self.appearance,
            "where": None if self.where is None else [round(each, 3) for each in self.where],
        }


@dataclass(frozen=True)
class QualityCheck:
    """A quality check: measurement, limits and messages."""

    key: str
    measures: str
    unit: str
    limits: tuple[float, ...]
    """Values at severity 1, 2 and 3; decreasing where less is worse. A check of a set has one, the
    limit of good values, and no severity; a note has none."""
    says: str
    """Message, formatted with `value`, `percent` and the caller's words."""
    cause: str = ""
    """Likely cause if the photograph shows no other, or ""."""
    remedy: str = ""
    """What to do, if the cause does not say it, or ""."""
    seen: str = ""
    """What a person sees in the sheet, of a check of a capture."""
    factor: bool = False
    """Whether the measurement is a ratio r, for which r and 1 / r are equally severe."""
    good: str = ""
    """Message if the rating is good, where it differs from `says`."""
    unknown: str = ""
    """Message if nothing can be measured."""

    def severity(self, value: float) -> float:
        """Severity of a measurement: 1, 2, 3 at the limits, linear between (in |log| of a factor).

        Where less is worse, it decreases from 1 at the first limit to 0 at as much more than it as
        the second limit is less.
        """
        limits = self.limits
        if self.factor:
            value = abs(math.log(max(value, 1e-9)))
            limits = tuple(map(math.log, limits))
        sign = 1.0 if limits[0] < limits[2] else -1.0
        value, (first, second, third) = sign * value, (sign * limit for limit in limits)
        if value <= first:
            start = 0.0 if first > 0.0 else 2.0 * first - second
            return max(0.0, (value - start) / (first - start))
        if value <= second:
            return 1.0 + (value - first) / (second - first)
        return 2.0 + (value - second) / (third - second)

    def finding(self, value: float, severity: float | None = None, **words: object) -> Finding:
        """The finding of a measurement; NaN where `unknown` says so, else it has failed.

        Args:
            severity: None is severity(value), of a note no rating. A check of a set is `rated`.
            words: further values of the messages.
        """
        if self.unknown and not math.isfinite(value):
            return Finding(self.key, None, Rating.NOT_JUDGED, self.unknown)
        if severity is None and self.limits:
            severity = self.severity(value)
        words |= {"value": value, "percent": 100.0 * value}
        return self.rated(round(float(value), 4), Rating.of(severity), severity or 0.0, **words)

    def rated(
        self, measurement: object, rating: Rating, severity: float = 0.0, **words: object
    ) -> Finding:
        """The finding of a measurement, as JSON, with a known rating."""
        good = rating is Rating.GOOD
        return Finding(
            self.key,
            measurement,
            rating,
            (self.good if good and self.good else self.says).format(**words),
            "" if good else self.remedy.format(**words),
            "" if good else self.cause.format(**words),
            severity,
        )


@dataclass(frozen=True)
class Cause:
    """A cause of a poor capture that the photograph shows, by a measurement of its own."""

    name: str
    measures: str
    none: float
    """Its value without this cause."""
    limit: float
    """Value from which the cause is reported."""
    says: str
    """Message, formatted with `value`, `percent`, `share` (percent, at most 100) and `ratio`,
    exp(value)."""
    remedy: str
    """What will help."""
    explains: frozenset[str]
    """Keys of the checks that it can affect."""

    def strength(self, value: float) -> float:
        """(value - none) / (limit - none): the cause is reported from 1."""
        return (value - self.none) / (self.limit - self.none)

    def described(self, value: float) -> Cause:
        """The cause with its message formatted."""
        ratio = math.exp(min(value, 99.0))  # of logarithms, which are smaller
        percent = 100.0 * value
        words = {"value": value, "percent": percent, "share": min(percent, 100.0), "ratio": ratio}
        return replace(self, says=self.says.format(**words))


def sentence(clause: str) -> str:
    """A clause as a sentence; sentences are returned unchanged."""
    if not clause or clause.endswith("."):
        return clause
    return f"{clause[0].upper()}{clause[1:]}."


_RETAKE = "photograph again, squarely from above, in the dark, a stop darker, RAW if you can"

_TABLE = (
    # Of the photograph.
    QualityCheck(
        "subject", "whether the picture shows a lit, flat material", "", (),
        "{what}", "{why}", "{do}", good="the picture is filled by one lit material",
    ),
    QualityCheck(
        "flash", "hot spot over border", "times", (1.5, 1.25, 1.12),
        "the photograph's middle is {value:.1f} times as bright as its border{fired}",
        "no flash, or other light",
        "photograph again with the flash switched on, not on automatic, and keep other light out",
    ),
    QualityCheck(
        "clipped", "pixels at their limit", "share of the photograph", (0.02, 0.08, 0.25),
        "{percent:.1f} % of the photograph is clipped", "it was exposed too long",
        "lower the exposure by a stop",
    ),
    QualityCheck(
        "hot_spot", "distance of the hot spot from the border", "share of a side", (0.12, 0.1, 0.0),
        "the hot spot is {where}", "the phone was held beside the sample",
        "hold the phone squarely above the middle: the highlight must be in the picture, whole",
    ),
    QualityCheck(
        "tilt", "angle between camera and sample", "degrees", (8.0, 14.0, 25.0),
        "the phone was tilted by {value:.0f} degrees{side}",
        "it was held askew, or other light came from one side",
        "lift the phone's {raised} side until it is parallel to the sample",
        good="the phone was square to the sample, within {value:.1f} degrees",
        unknown="the tilt was not measured",
    ),
    QualityCheck(
        "flash_offset", "distance of the flash from the lens", "plane units", (0.25, 0.35, 0.6),
        "the light seems to be {off:.0f} % of the picture's long side away from the lens, farther "
        "than a phone's flash",
        "other light, or a wrong field of view",
        "switch other lights off, and give --fov if you know it",
        good="the light is beside the lens, as a phone's flash",
    ),
    QualityCheck(
        "sharpness", "blur, standard deviation", "pixels", (1.5, 2.05, 2.6),
        "details smaller than {details:.0f} pixels are lost at {width} pixels across, unless the "
        "sample has none", "out of focus, or moved",
        "touch the middle of the screen to focus, and hold still",
        good="sharp at {width} pixels across",
        unknown="Sharpness cannot be measured, because the picture has no detail. Check by eye "
        "that the focus was on the sample.",
    ),
    QualityCheck(
        "stationarity", "difference between parts of the photograph", "times the usual",
        (2.0, 3.2, 4.5),
        "the sample does not look the same all over; it differs most {where}",
        "several materials, stains, a picture or shadows",
        "fill the picture with one material, without edges, stains, labels or shadows, or --crop "
        "to it",
        good="the sample looks the same all over",
    ),
    QualityCheck(
        "highlight", "radiance at the mirror point over a matte surface's", "", (),
        "the highlight is {value:.1f} times as bright as a matte surface would be there{more}",
        unknown="the photograph shows no gloss",
    ),
    # Of a set of photographs; directions are those of the first one as displayed.
    QualityCheck(
        "lit_from", "offset of the cameras to each side, over their height", "", (0.15,),
        "No photograph lights the sample from the {sides}.",
        remedy="Photograph again with the phone moved by a third of its distance to the {moves}"
        "{each}.", good="The sample is lit from all four sides.",
    ),
    QualityCheck(
        "baseline", "baseline of two cameras over their distance to the sample", "", (0.08,),
        "{one} and {other} were taken from nearly the same place.",
        remedy="Move the phone by a third of its distance from one to the next.",
        good="All were taken from different places.",
    ),
    QualityCheck(
        "steep", "tilt of a camera; a part of the finding `places`", "degrees", (50.0,),
        "{name} was taken {value:.0f} degrees off vertical.",
        remedy="Stay within 45 degrees of vertical: the far side is covered by few pixels.",
    ),
    QualityCheck(
        "cameras", "standard deviation of a camera's position over its distance", "", (0.002,),
        "Camera positions are uncertain by {percent:.2f} % of their distance ({name}), because the "
        "flash's shading moves with the camera.",
        remedy="None needed: a capture models the shading, which at least halves this.",
        good="Camera positions are uncertain by {percent:.2f} % of their distance.",
    ),
    QualityCheck(
        "overlap", "share of the sample that only one photograph shows", "", (0.25,),
        "{shared:.0f} % of the sample is in two photographs or more.",
        remedy="Aim the phone at the middle of the sample each time, so that all of it is in the "
        "picture.",
    ),
    # Of the capture: what a person sees in the sheet.
    QualityCheck(
        "photograph", "the worst of its subject, flash, clipping, tilt, unevenness and lamp", "",
        (),
        "{says}", seen="the photograph itself",
    ),
    QualityCheck(
        "highlight_contrast", "radiance at the mirror point over a matte surface's, or contrast of "
        "glints there, re-rendered over photographed", "times", (1.3, 2.0, 3.0),
        "{what} {value:.2g} times as strong as in the photograph{bound}", "",
        f"give --fov if you know it, or {_RETAKE}", "highlight too weak or too strong", factor=True,
        unknown="neither the photograph nor its re-rendering has a highlight",
    ),
    QualityCheck(
        "highlight_width", "half width of the highlight, re-rendered over photographed", "times",
        (1.3, 1.8, 3.0), "the highlight is {value:.1f} times as wide as in the photograph", "",
        f"give --fov if you know it, or {_RETAKE}", "highlight too wide or too narrow", factor=True,
    ),
    QualityCheck(
        "light", "log luminance difference that varies with position as light does", "share",
        (0.12, 0.22, 0.4),
        "shading across the picture differs from the photograph's by {percent:.0f} %",
        seen="light of the picture",
    ),
    QualityCheck(
        "colour", "log ratio of a channel, median", "share", (0.06, 0.15, 0.35),
        "colours are off by {percent:.0f} %", seen="wrong colour",
    ),
    QualityCheck(
        "texture", "distance of texture statistics", "times that between parts of the photograph",
        (1.2, 2.0, 3.0),
        "the texture differs from the photograph's {value:.1f} times as much as that does from "
        "place to place", seen="another texture",
        unknown="the picture is too small to compare textures",
    ),
    QualityCheck(
        "contrast", "contrast of a band of texture, re-rendered over photographed", "times",
        (1.25, 1.6, 2.5), "{band} is {more_or_less} than in the photograph",
        seen="texture too soft or too coarse", factor=True,
    ),
    QualityCheck(
        "spots", "depth of the brightest spots over that of the darkest, re-rendered over "
        "photographed, in the light or outside", "times", (1.35, 1.6, 2.5),
        "{what} over {other} are {more} times as strong as in the photograph",
        seen="specks or pits", factor=True,
    ),
    QualityCheck(
        "patches", "how much more the texture's direction differs from place to place than in the "
        "photographed rectangle, lit from the left and the top", "share", (0.15, 0.3, 0.7),
        "patches whose texture runs in other directions show when it is lit from a side",
        "patches of the photographed rectangle were put together that do not fit",
        "synth with --tile piece, which repeats that rectangle", "a quilt of patches",
        unknown="the field is not made of patches",
    ),
    QualityCheck(
        "pattern", "loss of autocorrelation at one period", "share", (0.3, 0.5, 0.75),
        "the pattern is {kept:.0f} % as regular as in the photograph",
        "cells or lines are broken, which small patches cut and decoders cannot draw",
        "capture with --generator example, or synth with a lower --variety", "pattern broken",
        unknown="the photograph shows no lattice",
    ),
    QualityCheck(
        "repeat", "times that each part is shown in a field as large as the photograph", "times",
        (10.0, 16.0, 30.0),
        "on an area as large as the photograph each part of it that is used is shown "
        "{value:.0f} times",
        "the rest of the photograph stands out or is shown too unlike, so that little of it is "
        "used",
        "photograph an even part of the sample, filling the picture", "a mark that repeats",
    ),
)  # fmt: skip
CHECKS: Mapping[str, QualityCheck] = {check.key: check for check in _TABLE}

UNIFORM = 0.1
"""Largest log ratio of the brightest side's light to that around the centre that is uniform light;
negative under a flash in any direction."""

_DARK = (
    "photograph in a dark room, with other lights off, or take one more without flash and give "
    "them with --together"
)
_OF_HIGHLIGHT = frozenset({"highlight_contrast", "highlight_width"})
_OF_LIGHT = _OF_HIGHLIGHT | {"light", "colour", "photograph"}

_CAUSES = (
    Cause(
        "anisotropic highlight", "length over width of the highlight, over the re-rendered one's",
        1.0, 1.35,
        "the highlight is a streak {value:.1f} times as long as wide: the reflection is "
        "anisotropic, as of brushed metal, which the maps cannot represent",
        "use an anisotropic shader in the renderer",
        _OF_HIGHLIGHT | {"light"},
    ),
    Cause(
        "light from a side", "log ratio of the brightest side's light to that around the centre, "
        "-inf if uniform", -0.3, 0.0,
        "other light from one side, which is {ratio:.1f} times as bright as the middle", _DARK,
        _OF_LIGHT,
    ),
    Cause(
        "room light", "uniform radiance over that of dark parts", 0.0, 0.25,
        "{share:.0f} % of the light in the dark parts is room light, not the flash's", _DARK,
        # A highlight of the wrong contrast looks like ambient light.
        _OF_LIGHT - {"highlight_contrast"},
    ),
    Cause(
        "large features", "patch size of the field: small patches at 1, the whole exemplar at 0",
        1.0, 0.2,
        "the pattern's features are almost as large as the photograph, too large to rearrange",
        "photograph more of the sample from farther away, or synth with --tile piece, which "
        "repeats that rectangle",
        frozenset({"texture", "pattern"}),
    ),
)  # fmt: skip
CAUSES: Mapping[str, Cause] = {cause.name: cause for cause in _CAUSES}
