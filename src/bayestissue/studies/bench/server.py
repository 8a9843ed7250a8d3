"""The server of a page: this machine alone, a token, JSON down, decisions up; no file but the page itself."""

from __future__ import annotations

import asyncio
import json
import secrets
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any, Protocol

from bayestissue.base.errors import InputError

if TYPE_CHECKING:
    import uvicorn
    from starlette.applications import Starlette
    from starlette.middleware.base import DispatchFunction, RequestResponseEndpoint
    from starlette.requests import Request
    from starlette.responses import Response

HOST = "127.0.0.1"
_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".csv": "text/csv"}
_HEADERS = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cache-control": "no-store",
}
_POLICY = (
    "default-src 'self'; img-src 'self' data:; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
# Figures are styled by attributes; a style runs no script.
_STYLED = f"{_POLICY}; style-src 'self' 'unsafe-inline'"
_LARGEST_BODY, _MOST_CONNECTIONS = 10_000, 64
# Between looks at whether there is something new, and between signs of life while there is not.
_LOOK_S, _SIGN_S = 0.2, 15.0
# Until whoever connects has asked for something, and until all of that has come.
_PATIENCE_S = 10.0


class View(Protocol):
    """What a page shows; called from several threads."""

    @property
    def has_figures(self) -> bool:
        """Whether its page has figures that the browser draws."""

    @property
    def version(self) -> int:
        """Another number after every change."""

    def read(self, name: str, query: Mapping[str, Sequence[str]]) -> Any:
        """What a page asks for: text of a file (``index.html`` is the page), else content of JSON.

        Raises KeyError where there is nothing of that name.
        """

    def act(self, action: str, content: dict[str, Any]) -> None:
        """Carry out what a button asks for. Raises KeyError, ValueError where that is nothing."""


def require_server(command: str, otherwise: str = "") -> None:
    """Refuse a ``command`` where the packages of the server are not installed.

    ``otherwise`` is what needs none.

    Raises:
        InputError: how to install them.
    """
    missing = [name for name in ("starlette", "uvicorn") if find_spec(name) is None]
    if missing:
        value = f"no {' and no '.join(missing)}"
        raise InputError.stated("no-campaign.server", command, value=value, otherwise=otherwise)


def application(view: View, port: int, token: str) -> Starlette:
    """The page of a view for those who know the token, by this machine's name and port alone."""
    from starlette.applications import Starlette
    from starlette.middleware import Middleware
    from starlette.middleware.base import BaseHTTPMiddleware
    from starlette.requests import ClientDisconnect
    from starlette.responses import JSONResponse, PlainTextResponse, Response, StreamingResponse
    from starlette.routing import Route

    def read(request: Request) -> Response:
        name = request.path_params.get("name", "index.html")
        query = {key: request.query_params.getlist(key) for key in request.query_params}
        try:
            content = view.read(name, query)
        except KeyError:
            return PlainTextResponse("there is no such thing", 404)
        except InputError as error:
            return PlainTextResponse(str(error), 422)
        media_type = _TYPES.get(PurePosixPath(name).suffix)
        return JSONResponse(content) if media_type is None else Response(content, media_type=media_type)

    async def act(request: Request) -> Response:
        body = b""
        try:
            async with asyncio.timeout(_PATIENCE_S):
                async for part in request.stream():
                    body += part
                    if len(body) > _LARGEST_BODY:
                        return PlainTextResponse("too long", 413)
        except (ClientDisconnect, TimeoutError):
            return PlainTextResponse("the rest is missing", 400)
        try:
            content = json.loads(body)
            await asyncio.to_thread(view.act, request.path_params["action"], content)
        except InputError as error:
            return PlainTextResponse(str(error), 422)
        except OSError as error:
            return PlainTextResponse(f"can't be written: {error.strerror}", 500)
        except (KeyError, ValueError, TypeError, AttributeError, RecursionError):
            return PlainTextResponse("nothing to be done", 400)
        return Response(status_code=204)

    async def events(_: Request) -> Response:
        async def bell() -> AsyncIterator[str]:
            last, spoke = -1, time.monotonic()
            while True:
                if view.version != last or time.monotonic() - spoke > _SIGN_S:
                    last, spoke = view.version, time.monotonic()
                    yield f"data: {last}\n\n"
                await asyncio.sleep(_LOOK_S)

        return StreamingResponse(bell(), media_type="text/event-stream")

    routes = [
        Route("/", read),
        Route("/events", events),
        Route("/{name}", read),
        Route("/act/{action}", act, methods=["POST"]),
    ]
    guarded = _guarding(port, token, _STYLED if view.has_figures else _POLICY)
    return Starlette(routes=routes, middleware=[Middleware(BaseHTTPMiddleware, dispatch=guarded)])


def _guarding(port: int, token: str, policy: str) -> DispatchFunction:
    """Lets through who knows the token and comes from this page, and adds headers that keep others out."""
    from starlette.responses import PlainTextResponse

    hosts = {f"{HOST}:{port}", f"localhost:{port}"}
    origins = {f"http://{name}" for name in hosts}
    # Cookies are of all ports of a host: two watches have two.
    cookie = f"bayestissue-{port}"

    def is_token(text: str) -> bool:
        return secrets.compare_digest(text.encode(), token.encode())

    async def guarded(request: Request, answer: RequestResponseEndpoint) -> Response:
        knows = request.scope["path"] == "/" and is_token(request.query_params.get("token", ""))
        reads = request.method in ("GET", "HEAD")
        same = request.headers.get("origin") in (origins | {None} if reads else origins)
        response: Response
        if request.headers.get("host") not in hosts or not same:
            response = PlainTextResponse("not from this page", 403)
        elif not knows and not is_token(request.cookies.get(cookie, "")):
            response = PlainTextResponse("open the whole address that the terminal shows", 403)
        else:
            response = await answer(request)
        response.headers.update(_HEADERS | {"content-security-policy": policy})
        if knows:
            response.headers["set-cookie"] = f"{cookie}={token}; Path=/; HttpOnly; SameSite=Strict"
        return response

    return guarded


def configured(app: Starlette) -> uvicorn.Server:
    """A server of a page, which ends within a second or two though pages are open.

    Connections that ask for nothing are closed after a while, or as soon as their place is needed.
    """
    import uvicorn
    from uvicorn.protocols.http.h11_impl import H11Protocol

    class Connection(H11Protocol):
        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            mine = [one for one in self.connections if isinstance(one, Connection)]
            open_ones = [one for one in mine if not one.transport.is_closing()]
            # Those that wait for nothing.
            silent = [one for one in open_ones if one.cycle is None or one.cycle.response_complete]
            if len(open_ones) >= _MOST_CONNECTIONS - 1 and silent:
                min(silent, key=lambda one: one.since).transport.close()
            super().connection_made(transport)
            self.since = self.loop.time()
            self.loop.call_later(_PATIENCE_S, self.end_if_nothing_came)

        def end_if_nothing_came(self) -> None:
            if self.cycle is None:
                self.transport.close()

    config = uvicorn.Config(
        app, log_level="error", access_log=False, lifespan="off", server_header=False, http=Connection,
        limit_concurrency=_MOST_CONNECTIONS, timeout_graceful_shutdown=1,
    )  # fmt: skip
    return uvicorn.Server(config)


def serve(view: View, port: int, say: Callable[[str], None], work: Callable[[], None] | None = None) -> None:
    """Serve a view until the command is stopped, ``work`` being done over and over meanwhile.

    Args:
        view: what the page shows.
        port: on this machine; a free one if 0.
        say: told the address.
        work: what it raises ends the server.

    Raises:
        InputError: another program has the port.
    """
    token = secrets.token_urlsafe(24)
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as listener:
        try:
            listener.bind((HOST, port))
            listener.listen()
        except OSError as error:
            raise InputError.stated("no-campaign.port", "--port", value=error.strerror, port=port) from None
        port = listener.getsockname()[1]
        server = configured(application(view, port, token))
        # In a thread of its own, where it leaves a request to stop to this one.
        serving = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
        say(f"open http://{HOST}:{port}/?token={token}")
        serving.start()
        try:
            while serving.is_alive():
                work() if work else time.sleep(_LOOK_S)
        except KeyboardInterrupt as request:
            request.add_note("what was decided is written")
            raise
        finally:
            server.should_exit = True
            serving.join()
