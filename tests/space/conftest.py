"""Small materials."""

from materials import a_material, make_material, material, wavy  # noqa: F401
from random_maps import maps  # noqa: F401
from small import prior  # noqa: F401
