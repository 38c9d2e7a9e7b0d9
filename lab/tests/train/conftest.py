"""Small photographs and a small untrained prior."""

from packs import pack, small_pack  # noqa: F401
from small import prior  # noqa: F401
