"""Runs the page's server, bound to 127.0.0.1 only."""

from __future__ import annotations

import os
import socket
import webbrowser
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING

from matcap.errors import MatcapError
from matcap.view.pages import Pages, Place
from matcap.view.server import Address, PagesOf, new_address
from matcap.view.subject import Viewable

if TYPE_CHECKING:
    from starlette.applications import Starlette

HOST = "127.0.0.1"
# (level, column, row) of the pages visible first, as initial() in page/view.js.
_FIRST = ((3, 0, 0), (0, 3, 3), (0, 4, 3), (0, 3, 4), (0, 4, 4))


def serve(
    make: Callable[[Address, PagesOf], Starlette],
    *,
    port: int = 0,
    opens: bool = True,
    announce: Callable[[str], None],
) -> None:
    """Serve a page until interrupted.

    Args:
        make: the application (server.py), of its address and a function to pages.
        port: 0 is a free one.
        opens: open the browser.
        announce: called with the address once requests are accepted.

    Raises:
        MatcapError: the port is taken, or the extra `view` is not installed.
    """
    try:
        import uvicorn
    except ImportError as error:
        raise MatcapError(
            "the page needs the extra 'view'",
            remedy='pip install "matcap[view]", or write one file with --html',
        ) from error
    import torch

    # A page is computed on one thread; threads must not change this setting concurrently.
    torch.set_num_threads(1)
    listening, opened = listen(port), ExitStack()
    address = new_address(listening.getsockname()[1])
    app = make(address, lambda subject: _begun(subject, opened))
    server = uvicorn.Server(
        uvicorn.Config(app, log_level="warning", lifespan="off", server_header=False)
    )
    announce(address.url)
    if opens:
        # Connections wait in the socket's queue until the server takes them.
        webbrowser.open(address.url)
    try:
        with suppress(KeyboardInterrupt):
            server.run(sockets=[listening])
    finally:
        opened.close()
        listening.close()


def _begun(subject: Viewable, opened: ExitStack) -> Pages:
    """Pages of a subject, with the first visible ones being computed while the browser starts."""
    pages = Pages(subject)
    opened.callback(pages.close)
    for level, column, row in _FIRST:
        pages.ask(Place(level, column, row, subject.facts.seed))
    return pages


def listen(port: int) -> socket.socket:
    """A listening socket on 127.0.0.1; port 0 is a free one.

    Raises:
        MatcapError: the port is taken or needs permission.
    """
    try:
        return socket.create_server((HOST, port), backlog=64)
    except OSError as error:
        raise MatcapError.at(
            "--port",
            f"the port {port} cannot be used ({os.strerror(error.errno or 0)})",
            "choose another, or leave it out",
        ) from error
