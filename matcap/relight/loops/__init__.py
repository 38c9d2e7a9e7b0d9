"""Inner loops of the renderer in C, compiled when matcap is installed; there is no fallback.

Tests compare each with a plain NumPy form (tests/relight/plain).
"""
