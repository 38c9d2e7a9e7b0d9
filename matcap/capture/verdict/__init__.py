"""A plain verdict on a capture: what a person would look at, in words.

`measurements.py` compares photograph and re-rendering, `findings.py` rates every measurement by the
table of checks (photo/checks.py), `judge.py` makes one verdict of them. How far it agrees with the
eye is in docs/notes/verdict.md.
"""
