"""The page's server, bound to 127.0.0.1: routes, and the check of requests.

It is reachable from this machine only, under an address with a random token. Requests with another
Host header are refused, against DNS rebinding. Routes are a fixed list and no request names a file,
so that there is no path traversal. Needs the extra `view`.
"""

from __future__ import annotations

import asyncio
import json
import os
import secrets
import socket
import webbrowser
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass

import torch
import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from matcap.errors import MatcapError, UsageError
from matcap.view.document import SCRIPTS, STYLE, page_file, served_page
from matcap.view.subject import EncodedPicture, Page, Pages, Place, Viewable

HOST = "127.0.0.1"
_POLL = 0.05  # seconds between checks whether the client has disconnected
# (level, column, row) of the pages visible first, as initial() in page/view.js.
_FIRST = ((3, 0, 0), (0, 3, 3), (0, 4, 3), (0, 3, 4), (0, 4, 4))
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; form-action 'self'; "
    "frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


def serve(
    subject: Viewable,
    photo: EncodedPicture | None = None,
    *,
    port: int = 0,
    opens: bool = True,
    announce: Callable[[str], None],
) -> None:
    """Serve the page of a subject until interrupted.

    Args:
        photo: the photograph.
        port: 0 is a free one.
        opens: open the browser.
        announce: called with the address once requests are accepted.

    Raises:
        MatcapError: the port is taken.
    """
    # A page is computed on one thread; threads must not change this setting concurrently.
    torch.set_num_threads(1)
    with closing(listen(port)) as listening, closing(Pages(subject)) as pages:
        for level, column, row in _FIRST:  # computed while the browser starts
            pages.ask(Place(level, column, row, subject.facts.seed))
        address = new_address(listening.getsockname()[1])
        app = make_app(pages, address, photo)
        server = uvicorn.Server(
            uvicorn.Config(app, log_level="warning", lifespan="off", server_header=False)
        )
        announce(address.url)
        if opens:
            # Connections wait in the socket's queue until the server takes them.
            webbrowser.open(address.url)
        with suppress(KeyboardInterrupt):
            server.run(sockets=[listening])


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


@dataclass(frozen=True)
class Address:
    """Port and secret token of the server."""

    port: int
    token: str

    @property
    def url(self) -> str:
        """Address that a browser opens."""
        return f"http://{HOST}:{self.port}/{self.token}/"


def new_address(port: int) -> Address:
    """An address with a random token."""
    return Address(port, secrets.token_urlsafe(24))


def make_app(pages: Pages, address: Address, photo: EncodedPicture | None = None) -> Starlette:
    """The application, behind the filter; a MatcapError is answered by its sentence.

    Args:
        pages: of the subject that is shown.
        address: whose token and host requests must have.
        photo: the photograph.
    """
    page = served_page(pages.subject.facts, photo)
    texts = {name: page_file(name) for name in (*SCRIPTS, STYLE)}

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

    async def part(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in texts:
            return PlainTextResponse("There is no such file.", 404)
        kind = "text/css" if name == STYLE else "text/javascript"
        return Response(texts[name], media_type=kind)

    return Starlette(
        routes=[
            Route("/", whole),
            Route("/photo", picture),
            Route("/alive", alive),
            Route("/page", texels),
            Route("/{name}", part),
        ],
        middleware=[Middleware(_RequestFilter, address=address)],
        exception_handlers={MatcapError: lambda _, error: PlainTextResponse(str(error), 400)},
    )


def _page_answer(page: Page) -> Response:
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
            "this does not name a page", remedy="give level, column, row, seed and share as numbers"
        ) from error


class _RequestFilter:
    """Middleware: refuses requests with a wrong token or host; adds headers to every response."""

    def __init__(self, app: ASGIApp, address: Address) -> None:
        self._app, self._token = app, address.token.encode()
        self._hosts = f"{HOST}:{address.port}", f"localhost:{address.port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return

        async def sealed(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(_HEADERS)
            await send(message)

        token, slash, rest = scope["path"].removeprefix("/").partition("/")
        known = secrets.compare_digest(token.encode(), self._token)
        if Headers(scope=scope).get("host") not in self._hosts:
            answer = PlainTextResponse("This server answers to its own address only.", 421)
            await answer(scope, receive, sealed)
        elif not known or not slash:
            refusal = "Open the whole address that matcap view printed."
            await PlainTextResponse(refusal, 403)(scope, receive, sealed)
        else:
            await self._app({**scope, "path": f"/{rest}"}, receive, sealed)
