"""The verdict on a capture from its findings and causes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from matcap.capture.verdict.causes import Cause, causes, more_photographs
from matcap.capture.verdict.findings import findings
from matcap.capture.verdict.measurements import Measurements
from matcap.photo.checks import Finding, Rating

NORM = 6.0
"""Exponent p of the severity (sum s^p)^(1/p): near the largest s, and a little above it for several
(three of 1.8 give 2.2); docs/notes/verdict.md."""


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
        """The finding with the largest severity."""
        return max(self.findings, key=lambda finding: finding.severity)

    def sentence(self) -> str:
        """The verdict in one line: rating, largest difference, likely cause and remedy."""
        if self.rating is Rating.GOOD:
            return f"{self.rating.value}: looks like the photograph"
        cause, remedy = self.cause()
        return f"{self.rating.value}: {self.worst.says}. {cause}. Remedy: {remedy}."

    def cause(self) -> tuple[str, str]:
        """Sentences on the likely cause of the largest difference and its remedy."""
        worst = self.worst
        for cause in self.causes:
            if worst.name in cause.explains:
                return f"Likely cause: {cause.says}", cause.remedy
        remedy = worst.remedy or more_photographs(self.photographs)
        if worst.cause:
            return f"Likely cause: {worst.cause}", remedy
        return "Cause unknown: no check of the photograph explains it", remedy

    def document(self) -> dict[str, Any]:
        """JSON (report.py describes the keys)."""
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
    """Rate measurements and look for causes."""
    return CaptureVerdict(tuple(findings(seen)), causes(seen.causes), seen.causes.photographs)
