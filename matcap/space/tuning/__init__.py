"""Fine-tuning of a decoder to a photograph [henzler2021, sec. 4.6]."""
