"""Training the space of materials: corpus, packs, training, and what the result is worth."""
