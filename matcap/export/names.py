"""Names that users type, checked against those there are."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

from matcap.errors import UsageError


def known(name: str, names: Iterable[str], where: str) -> str:
    """The name itself.

    Raises:
        UsageError: it is not among `names`; the remedy names the nearest of them, or all.
    """
    names = list(names)
    if name in names:
        return name
    near = get_close_matches(name.lower(), names, n=1)
    remedy = f"did you mean '{near[0]}'" if near else f"choose from {', '.join(names)}"
    raise UsageError(f"there is no '{name}'", where=where, remedy=remedy)
