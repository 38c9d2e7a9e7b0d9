"""Check of names that users type."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

from matcap.errors import UsageError


def known(name: str, names: Iterable[str], where: str) -> str:
    """Return `name` if it is in `names`.

    Raises:
        UsageError: it is not; the remedy is the most similar one, or the list.
    """
    names = list(names)
    if name in names:
        return name
    near = get_close_matches(name.lower(), names, n=1)
    remedy = f"did you mean '{near[0]}'" if near else f"choose from {', '.join(names)}"
    raise UsageError(f"there is no '{name}'", where=where, remedy=remedy)
