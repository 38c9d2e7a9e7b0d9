"""Capture: photograph to exemplar to material to folder, in named stages."""
