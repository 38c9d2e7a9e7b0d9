"""Verdict on a capture: rating, largest visible difference, likely cause and remedy.

`measurements.py` compares photograph and re-rendering, `causes.py` measures the maps and looks for
causes in the photograph, `judge.py` rates every measurement by the table of checks
(photo/checks.py) and makes one verdict. Its agreement with human ratings is in
docs/notes/verdict.md.
"""
