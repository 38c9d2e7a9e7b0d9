"""A page that shows a material: served on this machine, or as one file for sending.

Read subject.py for what is looked at, moments.py and afar.py for how it is shown from near and far,
pages.py for how it is cut, server.py for what is answered, document.py for how the page is put
together, and page/ for the page itself.
"""
