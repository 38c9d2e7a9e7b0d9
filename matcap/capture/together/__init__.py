"""Several photographs of one piece: what one flash leaves open, several close."""
