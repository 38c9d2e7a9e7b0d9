"""Reads photograph files to Photo: linear, white-balanced, oriented; inspection and calibration.

Start reading at load.py; raw.py and developed.py are the two kinds of file.
"""
