"""Training the prior: corpus, packs, training and evaluation."""
