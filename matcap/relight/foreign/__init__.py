"""Map sets of other programs, recognised by their files' names."""
