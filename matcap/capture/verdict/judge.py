"""The verdict on a capture: every measurement rated by the table of checks (photo/checks.py)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from matcap.capture.verdict.causes import UNSEEN, ExemplarMeasurements, causes
from matcap.capture.verdict.measurements import Measurements
from matcap.flash.highlight import FAINTEST_HIGHLIGHT, Highlight
from matcap.photo.checks import CHECKS, RESIDUES, Cause, Finding, Rating
from matcap.photo.inspect import whereabouts

NORM = 6.0
"""Exponent p of the severity (sum s^p)^(1/p): near the largest s, and a little above it for several
(three of 1.8 give 2.2); docs/notes/verdict.md."""
PHOTOGRAPHED = ("subject", "flash", "clipped", "tilt", "stationarity")
"""Keys of the photograph's own checks that are part of the verdict."""

_UNDETERMINED = "one photograph leaves open what of it is colour, gloss and relief"
_AT_HIGHLIGHT = frozenset(
    {"highlight_contrast", "glint_contrast", "highlight_place", "highlight_width",
     "highlight_residue", "clipped"}
)  # fmt: skip
_IN_TEXTURE = frozenset({"texture", "contrast", "exemplar", "connectivity", "order", "confidence"})
# Measurements from which a reason matters: clipped share of the highlight, blur in pixels,
# difference between parts, share of relief that is predicted.
_CLIPPED, _BLURRED, _UNEVEN, _PREDICTED = 0.05, 1.5, 1.2, 0.5
# Which highlights and lattices are compared; docs/notes/verdict.md.
_WIDEST = 0.34  # largest half width of a visible highlight, plane units (below that of the falloff)
_FAINTEST = 2.0  # least peak of a visible highlight over its surroundings
# Tolerance of a highlight's position: plane units, plus a share of its half width.
_PLACE_TOLERANCE = (0.03, 0.1)
_LEAST_ORDER = 0.15  # least autocorrelation at one period of a photograph with a visible lattice


@dataclass(frozen=True)
class CaptureVerdict:
    """Rating of a capture, with its findings and causes."""

    findings: tuple[Finding, ...]
    """All findings, in the order of the report."""
    causes: tuple[Cause, ...] = ()
    """Causes detected in the photograph, the strongest first."""
    photographs: int = 1
    """Number of photographs of the sample."""

    @property
    def severity(self) -> float:
        """NORM-norm of the findings' severities."""
        return float(sum(finding.severity**NORM for finding in self.findings) ** (1.0 / NORM))

    @property
    def rating(self) -> Rating:
        """Rating by severity: good up to 1, usable up to 2, doubtful up to 3, else failed."""
        return Rating.of(self.severity)

    @property
    def fit(self) -> bool:
        """Whether the rating is good or usable."""
        return self.rating.fit

    @property
    def worst(self) -> Finding:
        """The finding with the largest severity; without a material in the picture, that one."""
        first = self.findings[0]
        if first.name == "subject" and first.rating is Rating.FAILED:
            return first
        return max(self.findings, key=lambda finding: finding.severity)

    @property
    def appearances(self) -> dict[str, Finding]:
        """What a person sees, at most twelve: the worst finding of each of APPEARANCES."""
        worst: dict[str, Finding] = {}
        for finding in sorted(self.findings, key=lambda finding: finding.severity):
            worst[finding.appearance] = finding
        return worst

    def sentence(self) -> str:
        """The verdict in one line: rating, largest difference, likely cause and remedy."""
        first = self.findings[0]
        note = f" ({first.says})" if first.rating is Rating.NOT_JUDGED else ""
        if self.rating is Rating.GOOD:
            return f"{self.rating.value}: looks like the photograph{note}"
        cause, remedy = self.cause()
        worst, place = self.worst, ""
        if worst.where is not None and worst.name in _IN_TEXTURE:
            left, top, width, height = worst.where
            place = f", most of all {whereabouts(left + width / 2.0, top + height / 2.0)}"
        seen = f"{self.rating.value}: {worst.appearance}: {worst.says}{place}{note}"
        return f"{seen}. Why: {cause}. What helps: {remedy}."

    def cause(self) -> tuple[str, str]:
        """Clauses on the cause of the largest difference, and on what will help."""
        worst = self.worst
        if worst.name != "subject":
            for cause in self.causes:
                if worst.name in cause.explains:
                    return cause.says, cause.remedy
        repeats = any(finding.name == "order" for finding in self.findings)
        more = more_photographs(self.photographs, repeats=repeats)
        return worst.cause or _UNDETERMINED, worst.remedy or more

    def document(self) -> dict[str, Any]:
        """JSON (report.py describes the keys)."""
        return {
            "rating": self.rating.value,
            "fit": self.fit,
            "severity": round(self.severity, 3),
            "sentence": self.sentence(),
            "causes": [
                {"name": one.name, "message": one.says, "remedy": one.remedy} for one in self.causes
            ],
            "appearances": {
                name: finding.name
                for name, finding in self.appearances.items()
                if finding.severity > 1.0
            },
            "checks": {finding.name: finding.document() for finding in self.findings},
        }


def judge(seen: Measurements) -> CaptureVerdict:
    """Rate measurements and look for causes."""
    more = more_photographs(seen.photographs, repeats=seen.order is not None)
    judged = (_placed(_explained(finding, seen, more), seen) for finding in findings(seen))
    return CaptureVerdict(tuple(judged), causes(seen.causes, more), seen.photographs)


def _placed(finding: Finding, seen: Measurements) -> Finding:
    """The finding with the region of the picture where it is seen."""
    place = "highlight" if finding.name in _AT_HIGHLIGHT else "texture"
    if finding.where is not None or finding.name not in _AT_HIGHLIGHT | _IN_TEXTURE:
        return finding
    return replace(finding, where=seen.regions.get(place))


def _explained(finding: Finding, seen: Measurements, more: str) -> Finding:
    """The finding with the strongest measured reason; a finding with a cause is kept as it is."""
    if finding.cause or finding.severity <= 1.0:
        return finding
    reasons = [
        one for one in _reasons(seen, more) if one.strength >= 1.0 and finding.name in one.explains
    ]
    if not reasons:
        return finding
    best = max(reasons, key=lambda one: one.strength)
    return replace(finding, cause=best.why, remedy=best.remedy)


@dataclass(frozen=True)
class _Reason:
    strength: float
    """Measurement over the value from which it matters; the strongest is given."""
    why: str
    remedy: str
    explains: frozenset[str]
    """Keys of checks."""


def _reasons(seen: Measurements, more: str) -> Iterator[_Reason]:
    """Measured reasons why maps differ from the photograph."""
    photograph = {finding.name: finding for finding in seen.photograph.findings}

    def number(name: str) -> float:
        value = photograph[name].value if name in photograph else None
        return float(value) if isinstance(value, int | float) else 0.0

    clipped = 0.0 if seen.profile is None else seen.profile.clipped[0]
    yield _Reason(
        clipped / _CLIPPED, f"{clipped:.0%} of the highlight is clipped, so its peak is unknown",
        "take one more photograph from the same place, two to four stops darker, and capture both",
        _AT_HIGHLIGHT | {"colour"},
    )  # fmt: skip
    yield _Reason(
        number("sharpness") / _BLURRED, "the photograph is not sharp",
        "touch the sample on the screen to focus, and hold still", _IN_TEXTURE,
    )  # fmt: skip
    yield _Reason(
        number("stationarity") / _UNEVEN, "parts of the sample differ from each other",
        "capture the even part by --crop, or photograph another part of the sample",
        _IN_TEXTURE | {"light", "colour"},
    )  # fmt: skip
    confidence = seen.exemplar.confidence or {}
    relief = 1.0 - min((confidence[name] for name in ("height", "normal") if name in confidence),
                       default=1.0)  # fmt: skip
    yield _Reason(
        relief / _PREDICTED,
        "light from one place shows little of the relief across its direction", more,
        _IN_TEXTURE | {"glint_contrast", "highlight_residue"},
    )  # fmt: skip
    error, limit = seen.exemplar.error, CHECKS["exemplar"].limits[0]
    yield _Reason(
        float(error <= limit), "maps of the photographed rectangle fit it, rearranged ones less",
        "synthesise with a lower --variety, or make that rectangle repeat (synth --tile piece)",
        _IN_TEXTURE - {"exemplar", "confidence"},
    )  # fmt: skip
    yield _Reason(
        error / limit if error > limit else 0.0,
        "light from one place does not tell all of relief and gloss from colour", more,
        _IN_TEXTURE | {"glint_contrast", "highlight_residue"},
    )  # fmt: skip
    developed = "radiometric" in photograph and photograph["radiometric"].rating is not Rating.GOOD
    yield _Reason(
        float(developed),
        "a developed picture does not keep highlights and colours in proportion to light",
        "photograph RAW (DNG), or take one more a few stops darker and capture both",
        _AT_HIGHLIGHT | {"light", "colour", "exemplar"},
    )  # fmt: skip


def findings(seen: Measurements) -> Iterator[Finding]:
    """All findings, in the order of the report."""
    more = more_photographs(seen.photographs, repeats=seen.order is not None)
    yield from (seen.photograph[key] for key in PHOTOGRAPHED)
    yield from _highlight(seen, more)
    yield CHECKS["light"].finding(seen.light, more=more)
    yield CHECKS["colour"].finding(max(map(abs, seen.colour)), more=more)
    yield CHECKS["texture"].finding(seen.texture, more=more)
    yield _contrast(seen, more)
    yield _connectivity(seen)
    yield from _order(seen)
    yield from _exemplar(seen.exemplar, more)
    yield CHECKS["flash_offset"].finding(seen.offset, off=50.0 * seen.offset)


def more_photographs(given: int, *, repeats: bool = False) -> str:
    """Remedy for a capture that one or more photographs do not determine well enough.

    Of a pattern that `repeats` they can be registered only by what does not.
    """
    if given < 2:
        mark = ", with a border or a mark of the sample in each, as its pattern repeats"
        return (
            "take five photographs, one from above and one with the phone moved by a third of its "
            "distance to each side, so that each shows two thirds of the first"
            f"{mark if repeats else ''}, and give them with --together"
        )
    if given < 5:
        return f"add photographs from other sides to these {given}: five measure more"
    return "photograph again with the phone moved further to each side (see matcap inspect)"


def visible(highlight: Highlight | None) -> bool:
    """Whether a highlight is clearly visible."""
    return highlight is not None and highlight.width < _WIDEST and highlight.contrast > _FAINTEST


def _highlight(seen: Measurements, more: str) -> Iterator[Finding]:
    """Findings on the highlight: contrast, glints, position and width."""
    yield _highlight_contrast(seen)
    glints = math.nan if seen.profile is None else seen.profile.glint_ratio
    yield CHECKS["glint_contrast"].finding(glints, more=more)
    before, after = seen.highlights
    if before is None or after is None or not (visible(before) or visible(after)):
        return
    distance = math.dist(before.centre, after.centre)
    tolerance = _PLACE_TOLERANCE[0] + _PLACE_TOLERANCE[1] * before.width
    yield CHECKS["highlight_place"].finding(distance / tolerance, off=50.0 * distance)
    yield CHECKS["highlight_width"].finding(after.width / before.width)


def _highlight_contrast(seen: Measurements) -> Finding:
    """Highlight contrast, re-rendered over photographed: the worse of ring and peak contrast.

    Ring means miss a peak of a few texels, and a highlight that is not at the mirror point.
    """
    check, profile = CHECKS["highlight_contrast"], seen.profile
    ratios = [_peak_ratio(*seen.highlights), math.nan if profile is None else profile.ratio]
    known = [ratio for ratio in ratios if math.isfinite(ratio)]
    ratio = max(known, key=check.severity, default=math.nan)
    clipped = 0.0 if profile is None or not profile.bound else profile.clipped[0]
    bound = f", or less: {clipped:.0%} of the photograph's highlight is clipped" if clipped else ""
    return check.finding(ratio, bound=bound)


def _peak_ratio(before: Highlight | None, after: Highlight | None) -> float:
    """Ratio of peak over surroundings, re-rendered over photographed; NaN if neither is visible.

    An undetected highlight counts with the detection limit.
    """
    if not visible(before) and not visible(after):
        return math.nan
    first, second = (
        FAINTEST_HIGHLIGHT if each is None else each.contrast for each in (before, after)
    )
    return second / first


def _contrast(seen: Measurements, more: str) -> Finding:
    """Finding on texture contrast, in the band and region that differ most."""
    factors = {
        band: (after + UNSEEN) / (before + UNSEEN)
        for band, (before, after) in seen.contrast.items()
    }
    band = max(factors, key=lambda name: abs(math.log(factors[name])))
    factor = factors[band]
    says = f"{max(factor, 1.0 / factor):.1f} times {'stronger' if factor > 1.0 else 'weaker'}"
    return CHECKS["contrast"].finding(factor, more=more, band=band, more_or_less=says)


def _connectivity(seen: Measurements) -> Finding:
    """Finding on how well the pattern's dark or bright lines are connected."""
    check = CHECKS["connectivity"]
    if seen.connectivity is None:
        return check.finding(math.nan)
    before, after = seen.connectivity
    which, change = ("dark", after - before) if before > 0.0 else ("bright", before - after)
    more_or_less = "more" if change > 0.0 else "less"
    return check.finding(math.exp(abs(change)), which=which, more_or_less=more_or_less)


def _order(seen: Measurements) -> Iterator[Finding]:
    """Finding on how regular the pattern is; none for an aperiodic texture."""
    if seen.order is None:
        return
    before, after = seen.order
    kept = max(after, 0.0) / before if before >= _LEAST_ORDER else math.nan
    yield CHECKS["order"].finding(1.0 - kept, kept=100.0 * min(kept, 1.0))


def _exemplar(seen: ExemplarMeasurements, more: str) -> Iterator[Finding]:
    """Findings on the exemplar; none without one."""
    confidence, residue = seen.confidence, seen.residue
    if confidence is not None:
        yield CHECKS["exemplar"].finding(seen.error, more=more)
        predicted = 1.0 - sum(confidence.values()) / len(confidence)
        least = min(confidence, key=lambda name: confidence[name])
        yield CHECKS["confidence"].finding(predicted, least=least)
    if residue is not None:
        # In the map where it is most visible.
        name = max(RESIDUES, key=lambda name: residue[name] / RESIDUES[name][0])
        visible, says = RESIDUES[name]
        amount = says.format(residue[name] if name == "roughness" else math.exp(residue[name]))
        yield CHECKS["highlight_residue"].finding(residue[name] / visible, more=more, amount=amount)
    if math.isfinite(seen.steepness):
        yield CHECKS["steepness"].finding(seen.steepness)
