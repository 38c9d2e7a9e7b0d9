"""Scripts that are copied beside an export and run by other programs' Python; not imported here."""
