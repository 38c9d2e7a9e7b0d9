"""A page that shows a material: served on this machine, or as one file for sending.

subject.py is what is shown, level_of_detail.py filters it, pages.py cuts it into pages, server.py
answers requests, document.py composes the HTML document, and page/ is its source.
"""
