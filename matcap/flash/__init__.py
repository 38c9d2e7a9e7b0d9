"""Flash photographs of a flat material: geometry, rendering and the coarse fit."""
