"""From a photograph to a material: coarse fit, fine-tuning, freezing, report."""
