"""Surfaces a material is mapped onto: ray intersections and texture coordinates."""
