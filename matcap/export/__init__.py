"""Documents and packings of other programs."""
