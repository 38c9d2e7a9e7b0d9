"""The trained prior that settings name."""

from __future__ import annotations

from pathlib import Path


def prior_file(prior: str) -> Path | None:
    """Its file, which can be read; None where there is to be none.

    Args:
        prior: "auto", "none" or a file, as CaptureSettings has it.

    Raises:
        MatcapError: no such file, or no prior.
    """
    if prior == "none":
        return None
    from matcap.space.prior.store import SHIPPED, load_prior

    if prior == "auto":
        return SHIPPED
    # One that is broken would fail for every photograph.
    load_prior(Path(prior))
    return Path(prior)
