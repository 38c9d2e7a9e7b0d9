"""Measures of captures: statistics of relit pictures, and errors of maps."""
