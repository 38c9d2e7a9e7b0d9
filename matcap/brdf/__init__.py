"""SVBRDF maps, their files and normals, and the Cook-Torrance reflectance model."""
