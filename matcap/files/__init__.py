"""File formats and colour spaces, atomic writing, settings, and values that users type."""
