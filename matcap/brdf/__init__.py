"""Reflectance: the maps, their normals and the Cook-Torrance model. Knows nothing of files."""
