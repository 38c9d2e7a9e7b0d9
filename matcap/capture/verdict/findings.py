"""Every measurement of a capture rated by the table of checks (photo/checks.py)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from matcap.capture.verdict.causes import more_photographs
from matcap.capture.verdict.highlight import UNSEEN
from matcap.capture.verdict.measurements import Measurements
from matcap.flash.highlight import FAINTEST_HIGHLIGHT, Highlight
from matcap.photo.checks import CHECKS, Finding

PHOTOGRAPHED = ("flash", "clipped", "tilt", "stationarity")
"""Keys of the photograph's own checks that are part of the verdict."""


# Limits of visibility for the ratings; docs/notes/verdict.md.
_WIDEST = 0.34  # largest half width of a visible highlight, plane units (below that of the falloff)
_FAINTEST = 2.0  # least peak of a visible highlight over its surroundings
# Tolerance of a highlight's position: plane units, plus a share of its half width.
_PLACE_TOLERANCE = (0.03, 0.1)
_PLAIN_ORDER = 0.15  # least autocorrelation at one period of a photograph with a visible lattice


# By map: the smallest visible highlight residue, and its phrase in the verdict.
RESIDUES: Mapping[str, tuple[float, str]] = {
    "albedo": (0.05, "diffuse differs there by a factor of {:.2f}"),
    "specular": (0.15, "specular differs there by a factor of {:.2f}"),
    "roughness": (0.025, "roughness differs there by {:.2f}"),
    "grain": (0.3, "the relief's slopes differ there by a factor of {:.2f}"),
}


def findings(seen: Measurements) -> Iterator[Finding]:
    """All findings, in the order of the report."""
    more = more_photographs(seen.causes.photographs)
    yield from (seen.photograph[key] for key in PHOTOGRAPHED)
    yield from _highlight(seen)
    yield CHECKS["light"].finding(seen.light, more=more)
    yield CHECKS["colour"].finding(max(map(abs, seen.colour)), more=more)
    yield (
        CHECKS["texture"].finding(seen.texture, more=more)
        if math.isfinite(seen.texture)
        else CHECKS["texture"].not_judged("the picture is too small to compare textures")
    )
    yield _contrast(seen, more)
    yield _connectivity(seen)
    yield from _order(seen)
    yield from _piece(seen, more)
    if seen.residue is not None:
        yield _residue(seen.residue, more)
    if math.isfinite(seen.steepness):
        yield CHECKS["steepness"].finding(seen.steepness)
    yield CHECKS["flash_offset"].finding(seen.offset, off=50.0 * seen.offset)


def plain(highlight: Highlight | None) -> bool:
    """Whether a highlight is clearly visible."""
    return highlight is not None and highlight.width < _WIDEST and highlight.contrast > _FAINTEST


def _highlight(seen: Measurements) -> Iterator[Finding]:
    """Findings on the highlight: contrast, glints, position and width."""
    yield highlight_contrast(seen)
    glints = math.nan if seen.profile is None else seen.profile.glint_ratio
    yield (
        CHECKS["glint_contrast"].finding(glints, more=more_photographs(seen.causes.photographs))
        if math.isfinite(glints)
        else CHECKS["glint_contrast"].not_judged("no highlight shows glints")
    )
    before, after = seen.highlights
    if before is None or after is None or not (plain(before) or plain(after)):
        return
    distance = math.dist(before.centre, after.centre)
    tolerance = _PLACE_TOLERANCE[0] + _PLACE_TOLERANCE[1] * before.width
    yield CHECKS["highlight_place"].finding(distance / tolerance, off=50.0 * distance)
    yield CHECKS["highlight_width"].finding(after.width / before.width)


def highlight_contrast(seen: Measurements) -> Finding:
    """Highlight contrast, re-rendered over photographed: the worse of ring and peak contrast.

    Ring means miss a peak of a few texels, and a highlight that is not at the mirror point.
    """
    check, profile = CHECKS["highlight_contrast"], seen.profile
    ratios = [_peak_ratio(*seen.highlights), math.nan if profile is None else profile.ratio]
    known = [ratio for ratio in ratios if math.isfinite(ratio)]
    if not known:
        return check.not_judged("neither the photograph nor its re-rendering has a highlight")
    ratio = max(known, key=check.severity)
    clipped = 0.0 if profile is None or not profile.bound else profile.clipped[0]
    bound = f", or less: {clipped:.0%} of the photograph's highlight is clipped" if clipped else ""
    return check.finding(ratio, bound=bound)


def _peak_ratio(before: Highlight | None, after: Highlight | None) -> float:
    """Ratio of peak over surroundings, re-rendered over photographed; NaN if neither is visible.

    An undetected highlight counts with the detection limit.
    """
    if not plain(before) and not plain(after):
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
        return check.not_judged("the picture is too small to compare how its lines are connected")
    before, after = seen.connectivity
    which, change = ("dark", after - before) if before > 0.0 else ("bright", before - after)
    more_or_less = "more" if change > 0.0 else "less"
    return check.finding(math.exp(abs(change)), which=which, more_or_less=more_or_less)


def _order(seen: Measurements) -> Iterator[Finding]:
    """Finding on how regular the pattern is; none for an aperiodic texture."""
    if seen.order is None:
        return
    before, after = seen.order
    if before < _PLAIN_ORDER:
        yield CHECKS["order"].not_judged("the photograph shows no regular pattern to compare")
        return
    kept = max(after, 0.0) / before
    yield CHECKS["order"].finding(1.0 - kept, kept=100.0 * min(kept, 1.0))


def _piece(seen: Measurements, more: str) -> Iterator[Finding]:
    """Findings on the exemplar's re-rendering error and confidence; none without one."""
    if seen.exemplar is None:
        return
    yield CHECKS["piece"].finding(seen.exemplar["error"], more=more)
    confidence = {
        name: seen.exemplar[name] for name in seen.exemplar if name not in ("error", "slow")
    }
    least = min(confidence, key=lambda name: confidence[name])
    guessed = 1.0 - sum(confidence.values()) / len(confidence)
    yield CHECKS["confidence"].finding(guessed, least=least)


def _residue(residue: Mapping[str, float], more: str) -> Finding:
    """Finding on highlight residue, in the map where it is most visible."""
    name = max(RESIDUES, key=lambda one: residue[one] / RESIDUES[one][0])
    visible, says = RESIDUES[name]
    amount = residue[name] if name == "roughness" else math.exp(residue[name])
    return CHECKS["highlight_residue"].finding(
        residue[name] / visible, more=more, amount=says.format(amount)
    )
