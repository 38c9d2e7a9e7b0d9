"""Small photographs and a small untrained prior."""

from small import pack, prior, small_pack  # noqa: F401
