"""The page's server, bound to 127.0.0.1: routes, and the check of requests."""

from __future__ import annotations

import asyncio
import json
import os
import secrets
import socket
import webbrowser
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from matcap.errors import MatcapError, UsageError
from matcap.view.document import SCRIPTS, STYLE, page_file, served_page
from matcap.view.pages import EncodedPicture, Page, Pages, Place
from matcap.view.subject import Viewable

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.routing import BaseRoute
    from starlette.types import ASGIApp, Message, Receive, Scope, Send


# Routes of the page's server, and the check of its requests.
#
# The server is reachable from this machine only (server.py), under an address with a random token.
# Requests with another Host header are refused, against DNS rebinding. Routes are a fixed list and
# no request names a file, so that there is no path traversal.

PagesOf = Callable[[Viewable], Pages]

_POLL = 0.05  # seconds between checks whether the client has disconnected
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; form-action 'self'; "
    "frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


@dataclass(frozen=True)
class Address:
    """Port and secret token of the server."""

    port: int
    token: str

    @property
    def url(self) -> str:
        """Address that a browser opens."""
        return f"http://127.0.0.1:{self.port}/{self.token}/"

    @property
    def hosts(self) -> tuple[str, ...]:
        """Host headers that are accepted."""
        return f"127.0.0.1:{self.port}", f"localhost:{self.port}"


def new_address(port: int) -> Address:
    """An address with a random token."""
    return Address(port, secrets.token_urlsafe(24))


def make_app(
    subject: Viewable,
    address: Address,
    pages: PagesOf,
    photo: EncodedPicture | None = None,
) -> Starlette:
    """The server's application for one subject.

    Args:
        address: whose token and host requests must have.
        pages: returns the pages of a subject.
        photo: the photograph.
    """
    routes = _subject_routes(subject, pages(subject), photo)
    return _guarded(routes, address)


def _guarded(routes: Sequence[BaseRoute], address: Address) -> Starlette:
    """The application of routes, behind the filter; a MatcapError is answered by its sentence."""
    from starlette.applications import Starlette
    from starlette.middleware import Middleware
    from starlette.responses import PlainTextResponse

    return Starlette(
        routes=routes,
        middleware=[Middleware(_RequestFilter, address=address)],
        exception_handlers={MatcapError: lambda _, error: PlainTextResponse(str(error), 400)},
    )


def _parts(names: Sequence[str]) -> Callable[[Request], Awaitable[Response]]:
    """Handler of the page's own files."""
    from starlette.responses import PlainTextResponse, Response

    texts = {name: page_file(name) for name in (*names, STYLE)}

    async def part(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in texts:
            return PlainTextResponse("There is no such file.", 404)
        kind = "text/css" if name == STYLE else "text/javascript"
        return Response(texts[name], media_type=kind)

    return part


def _subject_routes(
    subject: Viewable, pages: Pages, photo: EncodedPicture | None
) -> list[BaseRoute]:
    from starlette.responses import HTMLResponse, PlainTextResponse, Response
    from starlette.routing import Route

    page = served_page(subject.facts, photo)

    async def whole(_: Request) -> Response:
        return HTMLResponse(page)

    async def picture(_: Request) -> Response:
        if photo is None:
            return PlainTextResponse("There is no such picture.", 404)
        return Response(photo.data, media_type=photo.kind)

    async def alive(_: Request) -> Response:
        return Response(status_code=204)

    async def texels(request: Request) -> Response:
        wanted = await _waited(pages, place_of(request.query_params), request)
        if wanted is None:
            return PlainTextResponse("The request was cancelled.", 499)
        return _page_answer(wanted)

    return [
        Route("/", whole),
        Route("/photo", picture),
        Route("/alive", alive),
        Route("/page", texels),
        Route("/{name}", _parts(SCRIPTS)),
    ]


def _page_answer(page: Page) -> Response:
    from starlette.responses import Response

    ends = dict(zip(("specular", "roughness", "height"), page.ends, strict=True))
    about = {
        "texel_size": page.texel_size, "ends": ends, "specular_channels": page.specular_channels,
    }  # fmt: skip
    headers = {"X-Page": json.dumps(about)}
    return Response(page.data, media_type="application/octet-stream", headers=headers)


async def _waited(pages: Pages, place: Place, request: Request) -> Page | None:
    """Wait for a page; None if the client disconnects."""
    while True:
        made = pages.ask(place)
        waiting = asyncio.wrap_future(made)
        while not (await asyncio.wait({waiting}, timeout=_POLL))[0]:
            if await request.is_disconnected():
                pages.drop(place)
                return None
        if not made.cancelled():  # another client of the same page may have cancelled it
            return waiting.result()


def place_of(values: Mapping[str, str]) -> Place:
    """Parse the query parameters of a page.

    Raises:
        UsageError: a parameter is missing or invalid.
    """
    try:
        level, column, row = (int(values[name]) for name in ("level", "column", "row"))
        seed, share = int(values.get("seed", "0")), float(values.get("share", "0"))
        if not 0.0 <= share <= 1.0:
            raise UsageError("the share is not between 0 and 1")
        return Place(level, column, row, seed, share)
    except (KeyError, ValueError) as error:
        raise UsageError(
            "this does not name a page",
            remedy="give level, column, row, seed and share as numbers",
        ) from error


class _RequestFilter:
    """Middleware: refuses requests with a wrong token or host; adds headers to every response."""

    def __init__(self, app: ASGIApp, address: Address) -> None:
        self._app = app
        self._address = address

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        from starlette.datastructures import Headers, MutableHeaders
        from starlette.responses import PlainTextResponse

        if scope["type"] != "http":
            return

        async def sealed(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(_HEADERS)
            await send(message)

        token, slash, rest = scope["path"].removeprefix("/").partition("/")
        known = secrets.compare_digest(token.encode(), self._address.token.encode())
        if Headers(scope=scope).get("host") not in self._address.hosts:
            answer = PlainTextResponse("This server answers to its own address only.", 421)
            await answer(scope, receive, sealed)
        elif not known or not slash:
            refusal = "Open the whole address that matcap view printed."
            await PlainTextResponse(refusal, 403)(scope, receive, sealed)
        else:
            await self._app({**scope, "path": f"/{rest}"}, receive, sealed)


# Runs the page's server, bound to 127.0.0.1 only.

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
