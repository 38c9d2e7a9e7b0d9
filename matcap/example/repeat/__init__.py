"""Seamless tile from the exemplar itself: flattened, straightened, cut along minimal seams."""
