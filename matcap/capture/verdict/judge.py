"""One verdict of all checks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from matcap.capture.verdict.causes import Cause, causes, more_photographs
from matcap.capture.verdict.checks import QualityCheck, all_checks
from matcap.capture.verdict.evidence import Evidence
from matcap.capture.verdict.rating import Rating


@dataclass(frozen=True)
class JudgeSettings:
    """How checks become one verdict; docs/notes/verdict.md."""

    norm: float = 6.0
    """That joins severities: the worst counts most, several small ones a little more than one
    (three of 1.8 are one of 2.2)."""
    told: int = 2
    """Checks in a sentence, the worst."""


JUDGE = JudgeSettings()


@dataclass(frozen=True)
class CaptureVerdict:
    """What a person would say of a capture."""

    checks: tuple[QualityCheck, ...]
    """All that was looked at."""
    causes: tuple[Cause, ...] = ()
    """What the photograph shows of why, the strongest first."""
    photographs: int = 1
    """That the capture was made of."""

    @property
    def severity(self) -> float:
        """Of all checks together, on their scale."""
        return float(sum(check.severity**JUDGE.norm for check in self.checks) ** (1.0 / JUDGE.norm))

    @property
    def rating(self) -> Rating:
        """The word."""
        return Rating.of(self.severity)

    @property
    def fit(self) -> bool:
        """Whether it is fit for use: good or usable."""
        return self.rating in (Rating.GOOD, Rating.USABLE)

    @property
    def faults(self) -> tuple[QualityCheck, ...]:
        """The worst checks that are not good, the worst first."""
        bad = [check for check in self.checks if check.rating is not Rating.GOOD]
        return tuple(sorted(bad, key=lambda check: -check.severity)[: JUDGE.told])

    def sentence(self) -> str:
        """The verdict in one line: the word, what was found, the likely cause and what to do."""
        if self.rating is Rating.GOOD or not self.faults:
            return f"{self.rating.value}: looks like the photograph"
        said = "; ".join(fault.says for fault in self.faults)
        cause, remedy = self.cause()
        return f"{self.rating.value}: {said}. {cause}. Remedy: {remedy}."

    def cause(self) -> tuple[str, str]:
        """What the worst fault comes from, as far as the photograph shows it, and what to do."""
        worst = self.faults[0]
        for cause in self.causes:
            if worst.name in cause.explains:
                return f"Likely cause: {cause.says}", cause.remedy
        if worst.cause:
            return f"Likely cause: {worst.cause}", worst.remedy
        return "The photograph shows no cause", worst.remedy or more_photographs(self.photographs)

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
            "checks": {
                check.name: {
                    "rating": check.rating.value,
                    "severity": round(check.severity, 3),
                    "says": check.says,
                    "cause": check.cause,
                    "remedy": check.remedy,
                }
                for check in self.checks
            },
        }


def judge(seen: Evidence) -> CaptureVerdict:
    """The verdict on what was measured."""
    return CaptureVerdict(
        tuple(all_checks(seen)), causes(seen.signs), photographs=seen.signs.photographs
    )
