"""Presentation of each experiment's table on the page that `matcap-lab bench report` writes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from matcap.errors import MatcapError
from matcap_lab.bench import fronts, relight
from matcap_lab.experiment.page import Presentation
from matcap_lab.experiment.results import read

PRESENTATIONS: Mapping[str, Presentation] = MappingProxyType(
    {
        "fronts": fronts.PRESENTATION,
        "relight": relight.PLAN,
        "tolerances": relight.TOLERANCE,
    }
)


def presentation_of(table: Path) -> Presentation:
    """Presentation of the experiment that wrote a CSV.

    Raises:
        MatcapError: it is empty or missing, or its experiment is not part of the report.
    """
    rows = read(table)
    if not rows or rows[0].experiment not in PRESENTATIONS:
        what = f"bench {rows[0].experiment} is not reported" if rows else "no rows stand in it"
        remedy = f"give a CSV of {', '.join(PRESENTATIONS)}"
        raise MatcapError.at(table, what, remedy)
    return PRESENTATIONS[rows[0].experiment]
