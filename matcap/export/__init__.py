"""Files out: map sets, pictures, and how both are written without leaving halves behind."""
