"""The effects a picture may call for, one a file; direct.py has the three every light asks for.

Each file says where its formula comes from, what it costs, and by how much at most a picture can
change when it is left out: `bound(limits)`, rigorous for the renderer at hand, in units of
radiance. What "left out" means is said there too. plan.py decides from the bounds.
"""
