"""The paper's generator: encoder, decoder on noise, prior, fine-tuning, blends and draws."""
