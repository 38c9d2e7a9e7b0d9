"""The verdict on a capture: every measurement rated by the table of checks (photo/checks.py)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from matcap.capture.verdict.causes import UNSEEN, causes
from matcap.capture.verdict.measurements import Measurements
from matcap.flash.highlight import FAINTEST_HIGHLIGHT, Highlight
from matcap.photo.checks import CHECKS, Cause, Finding, Rating
from matcap.photo.inspect import whereabouts

NORM = 6.0
"""Exponent p of the severity (sum s^p)^(1/p): near the largest s, and a little above it for several
(three of 1.8 give 2.2); docs/notes/verdict.md."""
PHOTOGRAPHED = ("subject", "flash", "clipped", "tilt", "stationarity", "flash_offset")
"""Keys of the photograph's own checks that are part of the verdict."""

_UNDETERMINED = "light from the lens does not tell colour, gloss and relief apart"
_DIRECTED = "light from one place shows little of the relief across its direction"
_FEW = "these photographs do not tell colour, gloss and relief apart"
_AT_HIGHLIGHT = frozenset({"highlight_contrast", "highlight_width"})
_IN_TEXTURE = frozenset({"texture", "contrast", "spots", "pattern"})
# What a fault of the photograph explains, by its check; the first is the likeliest.
_BY_PHOTOGRAPH = {
    "clipped": _AT_HIGHLIGHT | {"colour"},
    "sharpness": _IN_TEXTURE,
    "stationarity": _IN_TEXTURE | {"light", "colour"},
    "tilt": frozenset({"light"}),
}
_PREDICTED = 0.5  # share of relief that is predicted rather than measured, from which it matters
_GLINTS = "the glints"  # which no light that is smooth over the picture explains
_MISFIT = 0.12  # log radiance by which maps of the photographed rectangle do not explain it
_ITS_OWN = 0.75  # share of a severity that the exemplar itself has, from which it is the cause
# Which highlights and lattices are compared; docs/notes/verdict.md.
_WIDEST = 0.34  # largest half width of a visible highlight, plane units (below that of the falloff)
_FAINTEST = 2.0  # least peak of a visible highlight over its surroundings
_LEAST_ORDER = 0.15  # least autocorrelation at one period of a photograph with a visible lattice
_MOST_LISTED = 3  # small differences in a sentence
_SLIGHT = 0.6  # severity up to which a finding is not explained: any number of them is good


@dataclass(frozen=True)
class CaptureVerdict:
    """Rating of a capture, with its findings and causes."""

    findings: tuple[Finding, ...]
    """All findings, in the order of the report."""
    causes: tuple[Cause, ...] = ()
    """Causes detected in the photograph, the strongest first."""
    note: str = ""
    """What else limits the capture, as a clause; or ""."""

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
        """The finding with the largest severity; a photograph that has failed explains the rest."""
        first, *others = self.findings
        if first.rating is Rating.FAILED:
            return first
        # A photograph that is good is no difference that is seen.
        seen = others if first.rating is Rating.GOOD else self.findings
        return max(seen, key=lambda finding: finding.severity)

    @property
    def asks_for_exemplar(self) -> bool:
        """Whether the exemplar's own texture tells why: a fault of the texture is the worst."""
        return self.rating is not Rating.GOOD and self.worst.name in _IN_TEXTURE

    def sentence(self) -> str:
        """The verdict in one line: rating, largest difference, likely cause and remedy."""
        note = f" ({self.note})" if self.note else ""
        if self.rating is Rating.GOOD:
            return f"{self.rating.value}: looks like the photograph{note}"
        worst, place = self.worst, ""
        if worst.severity <= 1.0:
            small = [one for one in self.findings[1:] if _differs(one)]
            small = sorted(small, key=lambda one: -one.severity)[:_MOST_LISTED]
            listed = "; ".join(one.says for one in small)
            seen = f"{self.rating.value}: several small differences, none of them a fault"
            return f"{seen}: {listed}{note}."
        if worst.where is not None and worst.name in _IN_TEXTURE:
            left, top, width, height = worst.where
            place = f", most {whereabouts(left + width / 2.0, top + height / 2.0)}"
        seen = f"{self.rating.value}: {worst.says}{place}{note}"
        return f"{seen}. Why: {worst.cause}. What helps: {worst.remedy}."

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
                finding.appearance: finding.name
                for finding in self.findings
                if finding.severity > 1.0
            },
            "checks": {finding.name: finding.document() for finding in self.findings},
        }


def judge(seen: Measurements) -> CaptureVerdict:
    """Rate measurements and look for causes."""
    shown = causes(seen.causes)
    judged = (_explained(_placed(finding, seen), shown, seen) for finding in findings(seen))
    verdict = CaptureVerdict(tuple(judged), shown)
    subject, clipped = (seen.photograph[key] for key in ("subject", "clipped"))
    if subject.rating is Rating.NOT_JUDGED:
        return replace(verdict, note=subject.says)
    if verdict.rating is Rating.GOOD and not _fine(clipped):
        return replace(verdict, note=f"{clipped.says}: {clipped.remedy}")
    return verdict


def _placed(finding: Finding, seen: Measurements) -> Finding:
    """The finding with the region of the picture where it is seen."""
    place = finding.name if finding.name in seen.regions else "texture"
    place = "highlight" if finding.name in _AT_HIGHLIGHT else place
    if finding.where is not None or finding.name not in _AT_HIGHLIGHT | _IN_TEXTURE:
        return finding
    return replace(finding, where=seen.regions.get(place))


def _explained(finding: Finding, shown: tuple[Cause, ...], seen: Measurements) -> Finding:
    """The finding with why, and what helps, if it is visible.

    The strongest cause that can explain it, else its own, else a fault of the photograph.
    """
    if finding.severity <= _SLIGHT:
        return finding
    if finding.name != "photograph" or finding.rating is not Rating.FAILED:
        for cause in shown:
            if finding.name in cause.explains and not finding.says.startswith(_GLINTS):
                return replace(finding, cause=cause.says, remedy=cause.remedy)
    if finding.cause and finding.remedy:
        return finding
    unknown = _UNDETERMINED if seen.photographs < 2 else _FEW
    why, remedy = next(_reasons(finding, seen), (unknown, finding.remedy))
    more = more_photographs(seen.photographs, repeats=seen.order is not None)
    return replace(finding, cause=finding.cause or why, remedy=remedy or more)


def _reasons(finding: Finding, seen: Measurements) -> Iterator[tuple[str, str]]:
    """Why maps differ from the photograph in a check, and what helps, the likeliest first."""
    name, photograph = finding.name, {one.name: one for one in seen.photograph.findings}
    band = finding.says.split()[0] if name == "contrast" else ""
    for key, explains in _BY_PHOTOGRAPH.items():
        fault = photograph.get(key)
        # Blur hides fine texture alone.
        blameless = key == "sharpness" and band in ("coarse", "coloured")
        if fault is not None and name in explains and not _fine(fault) and not blameless:
            yield fault.says, fault.remedy
    if name in _IN_TEXTURE and (rearranged := _rearranged(finding, seen, band)) is not None:
        if rearranged:
            yield (
                "patches were put together wrongly; the photographed rectangle, lower on the "
                "sheet, is right",
                "synth with a lower --variety, or with --tile piece, which repeats that rectangle",
            )
        elif band != "coloured" and name != "spots":  # relief has no colour
            yield _DIRECTED if seen.photographs < 2 else _FEW, ""
    developed = photograph.get("radiometric")
    by_light = name in _AT_HIGHLIGHT | {"light", "colour"}
    if by_light and developed is not None and developed.rating is not Rating.GOOD:
        yield (
            "a developed picture does not keep highlights and colours in proportion to light",
            "photograph RAW (DNG), or take one more a few stops darker and capture both",
        )


def _rearranged(finding: Finding, seen: Measurements, band: str) -> bool | None:
    """Whether a fault of the texture is of its rearrangement, not of the maps; None if unknown."""
    if seen.itself is not None:
        own = next((one for one in findings(seen.itself) if one.name == finding.name), finding)
        if own.rating is not Rating.NOT_JUDGED:
            return own.severity < min(_ITS_OWN * finding.severity, 1.0)
    exemplar = seen.exemplar
    confidence = exemplar.confidence or {}
    relief = [confidence[name] for name in ("height", "normal") if name in confidence]
    # Gloss shows relief: what is weaker there is relief that is not known.
    lost = bool(band) and finding.value < 1.0 and "in the light" in finding.says
    unknown = any(each < 1.0 - _PREDICTED for each in relief)
    if band != "coloured" and (lost or unknown) or exemplar.error > _MISFIT:
        return False
    return True if confidence else None


def _differs(finding: Finding) -> bool:
    """Whether a small difference is worth a word: parts of the photograph differ as well."""
    alike = finding.name == "texture" and finding.value is not None and finding.value <= 1.0
    return finding.severity > _SLIGHT and not alike


def _fine(finding: Finding) -> bool:
    return finding.rating in (Rating.GOOD, Rating.NOT_JUDGED)


def findings(seen: Measurements) -> Iterator[Finding]:
    """All findings, in the order of the report."""
    rated = (one for one in seen.photograph.findings if one.name in PHOTOGRAPHED)
    own = max(rated, key=lambda one: one.severity)
    # What a usable photograph's faults do to the capture is measured below.
    severity = own.severity / 2.0 if own.rating.fit else own.severity
    rating = Rating.of(severity)
    yield replace(own, name="photograph", value=own.name, rating=rating, severity=severity)
    yield _highlight(seen)
    before, after = seen.highlights
    if before and after and (visible(before) or visible(after)):
        yield CHECKS["highlight_width"].finding(after.width / before.width)
    yield CHECKS["light"].finding(seen.light)
    yield CHECKS["colour"].finding(max(map(abs, seen.colour)))
    yield CHECKS["texture"].finding(seen.texture)
    yield _contrast(seen)
    yield _spots(seen.spots)
    yield _pattern(seen)
    yield CHECKS["patches"].finding(seen.patches - min(seen.patches, 1.0))
    if seen.exemplar.repeats:
        yield CHECKS["repeat"].finding(seen.exemplar.repeats)


def more_photographs(given: int, *, repeats: bool = False) -> str:
    """Remedy for a capture that one or more photographs do not determine well enough.

    Of a pattern that `repeats` they can be registered only by what does not.
    """
    if given < 2:
        mark = ", a mark in each (it repeats)" if repeats else ""
        return (
            "capture five photographs with --together, from above and moved to each side by a "
            f"third of the distance{mark}"
        )
    if given < 5:
        return f"add photographs from other sides to these {given}: five measure more"
    return "photograph again with the phone moved further to each side (see matcap inspect)"


def visible(highlight: Highlight | None) -> bool:
    """Whether a highlight is clearly visible."""
    return highlight is not None and highlight.width < _WIDEST and highlight.contrast > _FAINTEST


def _highlight(seen: Measurements) -> Finding:
    """Highlight contrast, re-rendered over photographed: the worst of rings, peak and glints.

    Ring means miss a peak of a few texels, and a highlight that is not at the mirror point.
    """
    check, profile = CHECKS["highlight_contrast"], seen.profile
    whole, parts = "the highlight is", f"{_GLINTS} in the highlight are"
    ratios = [(_peak_ratio(*seen.highlights), whole)]
    if profile is not None:
        ratios += [(profile.ratio, whole), (profile.glint_ratio, parts)]
    known = (one for one in ratios if math.isfinite(one[0]))
    ratio, what = max(known, key=lambda one: check.severity(one[0]), default=(math.nan, whole))
    clipped = 0.0 if profile is None or not profile.bound else profile.clipped[0]
    says = f", or less: {100.0 * clipped:.0f} % of the photograph's highlight is clipped"
    bound = says if clipped else ""
    return check.finding(ratio, what=what, bound=bound if what is whole else "")


def _peak_ratio(before: Highlight | None, after: Highlight | None) -> float:
    """Ratio of peak over surroundings, re-rendered over photographed; NaN if neither is visible.

    An undetected highlight counts with the detection limit.
    """
    if not visible(before) and not visible(after):
        return math.nan
    first, second = (FAINTEST_HIGHLIGHT if one is None else one.contrast for one in (before, after))
    return second / first


def _contrast(seen: Measurements) -> Finding:
    """Finding on texture contrast, in the band and region that differ most."""
    pairs = seen.contrast.items()
    factors = {band: (after + UNSEEN) / (before + UNSEEN) for band, (before, after) in pairs}
    band = max(factors, key=lambda name: abs(math.log(factors[name])))
    factor = factors[band]
    contrast = CHECKS["contrast"].finding(factor, band=band, more_or_less=_factor(factor))
    return replace(contrast, where=seen.regions.get(band))


def _spots(ratio: float) -> Finding:
    """Finding on spots, by the depth of bright ones over that of dark ones."""
    dark, bright = "dark pits", "bright specks"
    what, other = (bright, dark) if ratio > 1.0 else (dark, bright)
    more = f"{max(ratio, 1.0 / ratio):.1f}"
    return CHECKS["spots"].finding(ratio, what=what, other=other, more=more)


def _factor(factor: float) -> str:
    """A factor as text: so many times stronger or weaker."""
    return f"{max(factor, 1.0 / factor):.1f} times {'stronger' if factor > 1.0 else 'weaker'}"


def _pattern(seen: Measurements) -> Finding:
    """Finding on how regular a lattice is."""
    if seen.order is None or seen.order[0] < _LEAST_ORDER:
        return CHECKS["pattern"].finding(math.nan)
    before, after = seen.order
    kept = min(max(after, 0.0) / before, 1.0)
    return CHECKS["pattern"].finding(1.0 - kept, kept=100.0 * kept)
