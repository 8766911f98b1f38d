"""The page of a live ride and its WebSocket, for this machine alone.

It listens at 127.0.0.1. The address of the page has a token, without which everything is a 404. A WebSocket is taken
only from the page's own origin, and a request only if its Host is this server: so no other page that a browser shows
can read or steer the ride.
"""

from __future__ import annotations

import asyncio
import http
import json
import secrets
import threading
from collections.abc import Callable
from typing import Any, Final

from websockets.asyncio.server import ServerConnection, broadcast, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from bike_training.nodes.live_ride import checked_request

HOST: Final = "127.0.0.1"
MAX_REQUEST: Final = 1000
"""Largest message of a page, bytes."""
MAX_UNSENT: Final = 100_000
"""Bytes that wait for a slow page, beyond which it misses states; events, laps and status are kept."""
OPEN_TIMEOUT: Final = 1.0
"""Longest wait for the request of a connection, s: browsers open some in advance, and the end waits for them, too."""
MOST_PAGES: Final = 8
"""Pages that are open at the same time."""


class LiveServer:
    """Serves one page; `publish` and the requests go through one WebSocket for each that is open.

    Attributes:
        port: that it listens at.
        address: of the page, with its token.
    """

    port = 0

    def __init__(
        self,
        page: Callable[[str], str],
        requests: Callable[[dict[str, Any]], None],
        greeting: Callable[[], dict[str, Any]],
        port: int = 0,
    ) -> None:
        """Prepare a server.

        Args:
            page: makes the HTML from the origin of the WebSocket.
            requests: called with each checked request, from the server's thread.
            greeting: makes the first message for a page that connects.
            port: to listen at; 0 takes a free one.
        """
        self._make_page = page
        self._requests = requests
        self._wanted_port = port
        self._token = secrets.token_urlsafe(16)
        self._pages: set[ServerConnection] = set()
        self._loop = asyncio.new_event_loop()
        self._listening = threading.Event()
        self._failure: OSError | None = None
        self._thread = threading.Thread(target=self._run, name="live server", daemon=True)
        self._greeting = greeting

    @property
    def address(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.port}/{self._token}/"

    def start(self) -> None:
        """Listen.

        Raises:
            OSError: the port is taken.
        """
        self._thread.start()
        self._listening.wait()
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        """Close all pages and stop."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stopped.set)
            self._thread.join()

    def publish(self, message: dict[str, Any]) -> None:
        """Send a message to all pages, from any thread."""
        if self._thread.is_alive() and not self._loop.is_closed():
            text = json.dumps(message, separators=(",", ":"))
            self._loop.call_soon_threadsafe(self._put, text, "state" in message)

    def renew(self, page: Callable[[str], str]) -> None:
        """Serve another page from now on, from any thread; pages that are open stay until they load it."""
        if self._thread.is_alive() and not self._loop.is_closed():
            text = page(self._origin).encode()
            self._loop.call_soon_threadsafe(setattr, self, "_page", text)

    @property
    def _origin(self) -> str:
        return f"ws://{HOST}:{self.port}"

    # --------------------------------------------------------------------------------- in the server's thread

    def _run(self) -> None:
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._listening.set()
            self._loop.close()

    async def _serve(self) -> None:
        self._stopped = asyncio.Event()
        limits = {"max_size": MAX_REQUEST, "max_queue": 16, "open_timeout": OPEN_TIMEOUT}
        settings: dict[str, Any] = {"process_request": self._answer, **limits}
        try:
            server = await serve(self._talk, HOST, self._wanted_port, compression=None, **settings)
        except OSError as error:
            self._failure = OSError(f"port {self._wanted_port} cannot be opened: {error.strerror or error}")
            return
        async with server:
            self.port = next(iter(server.sockets)).getsockname()[1]
            self._page = self._make_page(self._origin).encode()
            self._listening.set()
            await self._stopped.wait()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the page, a refusal, or None where a WebSocket may be opened."""
        origin = f"http://{HOST}:{self.port}"
        if request.headers.get("Host") != f"{HOST}:{self.port}":
            return connection.respond(http.HTTPStatus.MISDIRECTED_REQUEST, "not this host\n")
        path = request.path.partition("?")[0]
        if secrets.compare_digest(path.encode(), f"/{self._token}/ws".encode()):
            if request.headers.get("Origin") != origin or len(self._pages) >= MOST_PAGES:
                return connection.respond(http.HTTPStatus.FORBIDDEN, "not from here\n")
            return None
        if not secrets.compare_digest(path.encode(), f"/{self._token}/".encode()):
            return connection.respond(http.HTTPStatus.NOT_FOUND, "nothing here; the address has a token\n")
        headers = Headers(
            {
                "Content-Type": "text/html; charset=utf-8",
                "Content-Length": str(len(self._page)),
                "Cache-Control": "no-store",
                "Referrer-Policy": "no-referrer",
                "X-Content-Type-Options": "nosniff",
                "X-Frame-Options": "DENY",
            }
        )
        return Response(200, "OK", headers, self._page)

    async def _talk(self, connection: ServerConnection) -> None:
        broadcast([connection], json.dumps(self._greeting()))
        self._pages.add(connection)
        try:
            async for text in connection:
                self._take(text)
        except ConnectionClosed:
            pass
        finally:
            self._pages.discard(connection)

    def _take(self, text: str | bytes) -> None:
        try:
            request = checked_request(json.loads(text))
        except (ValueError, RecursionError):
            return
        if request is not None:
            self._requests(request)

    def _put(self, text: str, passing: bool) -> None:
        pages = (page for page in self._pages if not passing or page.transport.get_write_buffer_size() < MAX_UNSENT)
        broadcast(pages, text)
