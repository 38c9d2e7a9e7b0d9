"""A photograph file to a `Photo`: linear light, white-balanced, oriented; nothing of networks.

Start reading at `load`; `raw` and `developed` are the two kinds of file.
"""
