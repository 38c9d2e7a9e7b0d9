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
PHOTOGRAPHED = ("subject", "flash", "clipped", "tilt", "stationarity", "flash_offset")
"""Keys of the photograph's own checks that are part of the verdict."""

_UNDETERMINED = "one photograph leaves open what of it is colour, gloss and relief"
_AT_HIGHLIGHT = frozenset({"highlight_contrast", "highlight_width", "highlight_residue"})
_IN_TEXTURE = frozenset({"texture", "contrast", "pits", "pattern"})
# What a fault of the photograph explains, by its check; the first is the likeliest.
_BY_PHOTOGRAPH = {
    "clipped": _AT_HIGHLIGHT | {"colour"},
    "sharpness": _IN_TEXTURE,
    "stationarity": _IN_TEXTURE | {"light", "colour"},
    "tilt": frozenset({"light"}),
}
_PREDICTED = 0.5  # share of relief that is predicted rather than measured, from which it matters
_MISFIT = 0.12  # log radiance by which maps of the photographed rectangle do not explain it
# Which highlights and lattices are compared; docs/notes/verdict.md.
_WIDEST = 0.34  # largest half width of a visible highlight, plane units (below that of the falloff)
_FAINTEST = 2.0  # least peak of a visible highlight over its surroundings
_LEAST_ORDER = 0.15  # least autocorrelation at one period of a photograph with a visible lattice
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

    def sentence(self) -> str:
        """The verdict in one line: rating, largest difference, likely cause and remedy."""
        note = f" ({self.note})" if self.note else ""
        if self.rating is Rating.GOOD:
            return f"{self.rating.value}: looks like the photograph{note}"
        worst, place = self.worst, ""
        if worst.severity <= 1.0:
            small = [one for one in self.findings[1:] if _differs(one)]
            listed = "; ".join(one.says for one in sorted(small, key=lambda one: -one.severity))
            seen = f"{self.rating.value}: several small differences, none of them a fault"
            return f"{seen}: {listed}{note}."
        if worst.where is not None and worst.name in _IN_TEXTURE:
            left, top, width, height = worst.where
            place = f", most of all {whereabouts(left + width / 2.0, top + height / 2.0)}"
        seen = f"{self.rating.value}: {worst.appearance}: {worst.says}{place}{note}"
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
            if finding.name in cause.explains:
                return replace(finding, cause=cause.says, remedy=cause.remedy)
    if finding.cause and finding.remedy:
        return finding
    why, remedy = next(_reasons(finding, seen), (_UNDETERMINED, finding.remedy))
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
    exemplar = seen.exemplar
    confidence = exemplar.confidence or {}
    relief = [confidence[name] for name in ("height", "normal") if name in confidence]
    if name in _IN_TEXTURE | {"highlight_residue"}:
        # Gloss shows relief: what is weaker there is relief that is not known.
        lost = bool(band) and finding.value < 1.0 and "in the light" in finding.says
        unknown = any(each < 1.0 - _PREDICTED for each in relief)
        misfit = exemplar.error > _MISFIT
        if band != "coloured" and (lost or unknown or misfit):  # relief has no colour
            yield "light from one place shows little of the relief across its direction", ""
        elif confidence and not misfit:
            yield (
                "maps of the photographed rectangle fit it, rearranged ones less",
                "synthesise with a lower --variety, or make that rectangle repeat (synth --tile "
                "piece)",
            )
    developed = photograph.get("radiometric")
    if developed is not None and developed.rating is not Rating.GOOD:
        yield (
            "a developed picture does not keep highlights and colours in proportion to light",
            "photograph RAW (DNG), or take one more a few stops darker and capture both",
        )


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
    yield replace(own, name="photograph", value=own.name, rating=Rating.of(own.severity))
    yield _highlight(seen)
    before, after = seen.highlights
    if before and after and (visible(before) or visible(after)):
        yield CHECKS["highlight_width"].finding(after.width / before.width)
    yield CHECKS["light"].finding(seen.light)
    yield CHECKS["colour"].finding(max(map(abs, seen.colour)))
    yield CHECKS["texture"].finding(seen.texture)
    yield _contrast(seen)
    # Shallower spots are of a weaker texture.
    yield CHECKS["pits"].finding(max(1.0, seen.pits))
    yield _pattern(seen)
    yield from _exemplar(seen.exemplar)


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


def _highlight(seen: Measurements) -> Finding:
    """Highlight contrast, re-rendered over photographed: the worst of rings, peak and glints.

    Ring means miss a peak of a few texels, and a highlight that is not at the mirror point.
    """
    check, profile = CHECKS["highlight_contrast"], seen.profile
    whole, parts = "highlight is", "glints in the highlight are"
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
    says = f"{max(factor, 1.0 / factor):.1f} times {'stronger' if factor > 1.0 else 'weaker'}"
    contrast = CHECKS["contrast"].finding(factor, band=band, more_or_less=says)
    return replace(contrast, where=seen.regions.get(band))


def _pattern(seen: Measurements) -> Finding:
    """Finding on how regular a lattice is."""
    if seen.order is None or seen.order[0] < _LEAST_ORDER:
        return CHECKS["pattern"].finding(math.nan)
    before, after = seen.order
    kept = min(max(after, 0.0) / before, 1.0)
    return CHECKS["pattern"].finding(1.0 - kept, kept=100.0 * kept)


def _exemplar(seen: ExemplarMeasurements) -> Iterator[Finding]:
    """Findings on the exemplar and its rearrangement; none without one."""
    if seen.repeats:
        yield CHECKS["repeat"].finding(seen.repeats)
    if seen.residue is not None:
        # In the map where it is most visible.
        residue = seen.residue
        name = max(RESIDUES, key=lambda name: residue[name] / RESIDUES[name][0])
        visible, says = RESIDUES[name]
        amount = says.format(residue[name] if name == "roughness" else math.exp(residue[name]))
        yield CHECKS["highlight_residue"].finding(residue[name] / visible, amount=amount)
