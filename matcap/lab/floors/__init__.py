"""How far a capture is from the truth, by a measure that nothing is tuned by."""
