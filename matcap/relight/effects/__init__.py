"""Effects of the renderer, one a file; direct.py has the three of every light.

Each file states the formula with its source, the picture without the effect ("Left out"), the cost,
and `bound(limits)`: a rigorous upper bound, in radiance, on the change from leaving it out.
render.py decides from the bounds.
"""
