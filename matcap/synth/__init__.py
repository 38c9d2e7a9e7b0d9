"""Writes rectangles of a material's field, of any size, to files."""
