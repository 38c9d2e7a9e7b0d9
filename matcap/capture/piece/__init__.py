"""The maps of the photographed piece itself: network, strength, refinement, confidence."""
