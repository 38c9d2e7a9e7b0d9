"""File of the trained prior that `CaptureSettings.prior` names."""

from __future__ import annotations

from pathlib import Path


def prior_file(prior: str) -> Path | None:
    """Path of a prior that can be loaded, or None for "none".

    Args:
        prior: "auto" (the shipped prior), "none" or a path.

    Raises:
        MatcapError: the file does not exist, or holds no prior.
    """
    if prior == "none":
        return None
    from matcap.space.prior.store import SHIPPED, load_prior

    if prior == "auto":
        return SHIPPED
    # Load it now: a broken one would fail for every photograph.
    load_prior(Path(prior))
    return Path(prior)
