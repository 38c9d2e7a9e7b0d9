"""Map sets of other programs: which file is which map, and how each is encoded."""
