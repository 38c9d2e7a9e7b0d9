"""The endless field by example: rearranges an exemplar [lefebvre2005] [lefebvre2006]."""
