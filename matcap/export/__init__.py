"""Export of maps to other programs: documents, and textures in their naming and packing."""
