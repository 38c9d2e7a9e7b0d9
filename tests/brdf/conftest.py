"""Map sets to write."""

from random_maps import maps  # noqa: F401
