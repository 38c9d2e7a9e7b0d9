"""Estimation of the exemplar: network, relief spectrum, refinement, confidence, inpainting."""
