"""The version of matcap: what files say they were written by."""

__version__ = "0.1.0"
