"""Sweeps that look for what comes out NaN, infinite or wrong in float32."""
