"""The numeric edges of relighting and exporting, against float64 and closed forms."""
