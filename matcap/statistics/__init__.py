"""What makes two textures look alike: features, Gram matrices, spectra, and their comparison."""
