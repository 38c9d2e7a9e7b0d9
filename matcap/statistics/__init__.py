"""Texture statistics: features, Gram matrices, spectra, and a distance between them."""
