"""The inverse network: one flash photograph to maps of the exemplar."""
