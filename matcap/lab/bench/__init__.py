"""What the documentation claims, measured: how like the sample a capture looks under new lights."""
