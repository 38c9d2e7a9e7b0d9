"""A small untrained prior."""

from small import prior  # noqa: F401
