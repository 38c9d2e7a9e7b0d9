"""Seamless tile from the exemplar itself: flattened, straightened, cut along a minimal seam."""
