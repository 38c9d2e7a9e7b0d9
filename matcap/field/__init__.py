"""Endless maps: their blocks, Field, Material and its file, and what generators implement."""
