"""Files, whatever is in them: staged writing, EXR, PNG, the sRGB curve, values that users type."""
