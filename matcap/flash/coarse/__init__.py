"""The coarse fit: a uniform material, camera and flash fitted to a photograph. See fit.py."""
