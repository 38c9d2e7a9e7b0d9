"""The space of materials: a corpus of photographs, training, the shipped weights, measurements."""
