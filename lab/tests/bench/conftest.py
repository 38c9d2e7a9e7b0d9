"""A small material."""

from materials import a_material, material  # noqa: F401
