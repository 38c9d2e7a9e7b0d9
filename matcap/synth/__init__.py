"""A material's field to files of any size."""
