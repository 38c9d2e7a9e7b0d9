"""The inner loops of relighting: C, built with the package. There is no other form of them here.

tests/relight/plain has each as plain NumPy, slowly, which the tests hold these to.
"""
