"""One verdict of all findings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from matcap.capture.verdict.causes import Cause, causes, more_photographs
from matcap.capture.verdict.findings import findings
from matcap.capture.verdict.measurements import Measurements
from matcap.photo.checks import Finding, Rating

NORM = 6.0
"""That joins severities: the worst counts most, several small ones a little more than one (three of
1.8 are one of 2.2); docs/notes/verdict.md."""


@dataclass(frozen=True)
class CaptureVerdict:
    """Rating of a capture, with its findings and causes."""

    findings: tuple[Finding, ...]
    """All that was looked at."""
    causes: tuple[Cause, ...] = ()
    """What the photograph shows of why, the strongest first."""
    photographs: int = 1
    """That the capture was made of."""

    @property
    def severity(self) -> float:
        """Of all findings together, on their scale."""
        return float(sum(finding.severity**NORM for finding in self.findings) ** (1.0 / NORM))

    @property
    def rating(self) -> Rating:
        """The word."""
        return Rating.of(self.severity)

    @property
    def fit(self) -> bool:
        """Whether it is fit for use: good or usable."""
        return self.rating.fit

    @property
    def worst(self) -> Finding:
        """The largest difference."""
        return max(self.findings, key=lambda finding: finding.severity)

    def sentence(self) -> str:
        """The verdict in one line: the word, the largest difference, its cause and what to do."""
        if self.rating is Rating.GOOD:
            return f"{self.rating.value}: looks like the photograph"
        cause, remedy = self.cause()
        return f"{self.rating.value}: {self.worst.says}. {cause}. Remedy: {remedy}."

    def cause(self) -> tuple[str, str]:
        """(likely cause of the largest difference, remedy), sentences."""
        worst = self.worst
        for cause in self.causes:
            if worst.name in cause.explains:
                return f"Likely cause: {cause.says}", cause.remedy
        remedy = worst.remedy or more_photographs(self.photographs)
        if worst.cause:
            return f"Likely cause: {worst.cause}", remedy
        return "The photograph shows no cause for it", remedy

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "rating": self.rating.value,
            "fit": self.fit,
            "severity": round(self.severity, 3),
            "sentence": self.sentence(),
            "causes": [
                {"name": one.name, "says": one.says, "remedy": one.remedy} for one in self.causes
            ],
            "checks": {finding.name: finding.document() for finding in self.findings},
        }


def judge(seen: Measurements) -> CaptureVerdict:
    """The verdict on what was measured."""
    return CaptureVerdict(tuple(findings(seen)), causes(seen.causes), seen.causes.photographs)
