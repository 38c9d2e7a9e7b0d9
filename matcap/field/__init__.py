"""The contract of endless maps: blocks, the field, and the material with its file."""
