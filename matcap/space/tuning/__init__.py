"""A decoder tuned to one photograph, or to several (paper, 4.6)."""
