"""The paper's generator [henzler2021]: encoder, decoder, prior, fine-tuning, blends and draws."""
