"""Batch capture: every photograph of a folder to a material; failures are kept and reported.

Start reading at `run`, which is the order of events. `shoot` finds the photographs, `identity`
says what a material was made from, `record` and `workspace` are the files that the truth is read
from, `work` is what a worker does, `crew` the worker processes and `index` the page at the end.
"""
