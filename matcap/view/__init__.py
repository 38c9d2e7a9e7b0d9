"""A page that shows a material: served on this machine, or as one file for sending.

Read subject.py for what is shown, moments.py and level_of_detail.py for how it is filtered,
pages.py for how it is cut, server.py for what is answered, document.py for how the page is put
together, and page/ for the page itself.
"""
