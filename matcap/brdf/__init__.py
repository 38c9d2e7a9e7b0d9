"""Reflectance: the maps and their files, their normals and the Cook-Torrance model."""
