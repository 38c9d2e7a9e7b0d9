"""The endless field by example: rearranges an exemplar (Lefebvre and Hoppe 2005, 2006)."""
