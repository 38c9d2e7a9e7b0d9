"""The loops of matcap.relight.loops as plain NumPy, which they are held to."""
