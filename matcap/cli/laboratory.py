"""Check that the laboratory (experiments and training), a separate install, is there."""

from __future__ import annotations

from importlib.util import find_spec

from matcap.errors import MatcapError


def require_laboratory() -> None:
    """Check that the laboratory is installed.

    Raises:
        MatcapError: it is not.
    """
    if find_spec("matcap.lab") is None:
        raise MatcapError(
            "this command measures or trains, and the laboratory is not installed",
            remedy="install it from a clone of matcap with: pip install ./matcap/lab",
        )
