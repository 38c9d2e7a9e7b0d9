"""Scripts that are copied into an export and run in other programs' Python; never imported."""
