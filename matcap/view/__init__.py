"""A page that shows a material: served on this machine, or as one file for sending.

subject.py is what is shown and cuts it into pages, level_of_detail.py filters it, server.py
answers requests, document.py composes the HTML document, and page/ is its source.
"""
