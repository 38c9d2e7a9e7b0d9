"""From a photograph to a piece to a material to a folder: one named stage after another."""
