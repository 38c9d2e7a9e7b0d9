"""A plain verdict on a capture: what a person would look at, in words.

`evidence.py` measures photograph and re-rendering alike, `checks.py` rates each measure, `judge.py`
makes one verdict of them. How far it agrees with the eye is in docs/notes/verdict.md.
"""
