"""What all pages have in common: who may read them, who may change something, and their errors.

The token comes once in the address and then in a cookie, so that it stays out of the history and
of the Referer header. Requests for another host name are refused, since a page of a stranger could
send them by a name that it has resolve to this machine (DNS rebinding). What changes something must
come from a page of ours, by its Origin, and with a token of its own in a header, which only who can
read the page has.
"""

import asyncio
import hmac
import logging
import secrets
import socket
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream
from tornado.web import Application, HTTPError, RequestHandler

from bo_tuner.errors import BoTunerError
from bo_tuner.text import printable
from bo_tuner.web.address import TOKEN_BYTES, is_own_host

LARGEST_REQUEST = 16_384
"""Size of a request's head, and of its body [byte]."""
LONGEST_REQUEST = 5.0
"""Time [s] in which the head of a request must be there: a browser sends it at once."""
MOST_CONNECTIONS = 100
"""Connections at a time, those of some ten browsers; each takes a file descriptor of few."""
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "Server": "bo_tuner",
    "X-Content-Type-Options": "nosniff",
}


@dataclass(frozen=True)
class Access:
    """Who may read the pages, and who may change something.

    Attributes
    ----------
    token
        Whoever has it may read them.
    host, port
        Of the `Address`.
    control
        The token of requests that change something; empty if there are none.
    """

    token: str
    host: str
    port: int
    control: str = ""

    @property
    def cookie(self) -> str:
        """Name of the cookie; cookies of one host are shared by all its ports."""
        return f"bo_tuner_{self.port}"


def new_control_token() -> str:
    """Return a token that nobody can guess."""
    return secrets.token_urlsafe(TOKEN_BYTES)


class Page(RequestHandler):
    """Base of all pages: checks host and token."""

    def initialize(self, **shared: Any) -> None:
        """Take what pages share: all of them who may read them."""
        self.access: Access = shared["access"]

    def set_default_headers(self) -> None:
        """Set the headers of every answer, errors included."""
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        """Refuse who does not know the token, and who asks for another host."""
        access = self.access
        if not is_own_host(self.request.host, access.port, access.host):
            raise HTTPError(403, "the host name is not that of this page")
        given = self.get_query_argument("token", "") or self.get_cookie(access.cookie, "") or ""
        if not hmac.compare_digest(given.encode(), access.token.encode()):
            raise HTTPError(403, "open the address that the command has printed, with its token")

    def enter(self) -> bool:
        """Put a token in the address into a cookie, and go on without it; False without one."""
        if not self.get_query_argument("token", ""):
            return False
        access = self.access
        self.set_cookie(access.cookie, access.token, path="/", httponly=True, samesite="Strict")
        self.redirect("/")
        return True

    def check_control(self) -> None:
        """Refuse a request to change something, unless it is from a page of ours."""
        if not self.access.control:
            raise HTTPError(403, "the page is read-only; --web-control allows requests")
        if self.request.headers.get("Origin", "") != f"http://{self.request.host}":
            raise HTTPError(403, "the request is not from this page")
        given = self.request.headers.get("X-Control-Token", "")
        if not hmac.compare_digest(given.encode(), self.access.control.encode()):
            raise HTTPError(403, "the request is not from this page, or from one of an earlier run")

    async def made(self, missing: str, thread: Executor, make: Any, *arguments: Any) -> Any:
        """Return what is made in a thread; without it answer that it is `missing`."""
        try:
            loop = asyncio.get_running_loop()
            found = await loop.run_in_executor(thread, make, *arguments)
        except BoTunerError as error:
            raise HTTPError(409, "%s", error) from None
        if found is None:
            raise HTTPError(404, missing)
        return found

    def log_exception(self, *error: Any) -> None:
        """Log what is a fault of ours, without the address: it may hold the token."""
        if not isinstance(error[1], HTTPError):
            logging.getLogger(__name__).error("%s", self.request.path, exc_info=error)

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        """Answer in a line of text."""
        _, error, _ = kwargs.get("exc_info", (None, None, None))
        said = ""
        if isinstance(error, HTTPError) and error.log_message:
            said = error.log_message % error.args
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code}: {printable(said) or self._reason}\n")


Route = tuple[str, type[Page], dict[str, Any]]
"""Pattern of a page's address, its handler, and what that shares beside `Access`."""


class Missing(Page):
    """Any other address."""

    def get(self) -> None:
        """Answer that there is nothing, to who may know."""
        raise HTTPError(404, "there is no such page")


class Server(HTTPServer):
    """Takes up to `MOST_CONNECTIONS` at a time, and closes further ones at once.

    Without a bound the descriptors of the process run out, of which tornado logs a traceback at
    each of its vain attempts to accept the next connection.
    """

    def initialize(self, *arguments: Any, **settings: Any) -> None:
        """Begin without connections."""
        super().initialize(*arguments, **settings)
        self._count = 0
        self._has_refused = False

    def handle_stream(self, stream: IOStream, address: tuple[Any, ...]) -> None:
        """Serve a connection, or close it."""
        if self._count >= MOST_CONNECTIONS:
            stream.close()
            if not self._has_refused:
                self._has_refused = True
                logging.getLogger(__name__).warning(
                    "more than %d connections at a time: further ones are closed", MOST_CONNECTIONS
                )
            return
        self._count += 1
        super().handle_stream(stream, address)

    def on_close(self, server_conn: object) -> None:
        """Count a connection that has ended."""
        self._count -= 1
        super().on_close(server_conn)


def start_server(listening: socket.socket, access: Access, routes: Sequence[Route]) -> Server:
    """Begin to serve pages."""
    shared = {"access": access}
    application = Application(
        [(pattern, handler, shared | settings) for pattern, handler, settings in routes],
        default_handler_class=Missing,
        default_handler_args=shared,
        compress_response=True,
        # A log of requests would hold the token.
        log_function=lambda handler: None,
    )
    server = Server(
        application,
        max_header_size=LARGEST_REQUEST,
        max_body_size=LARGEST_REQUEST,
        idle_connection_timeout=LONGEST_REQUEST,
    )
    listening.setblocking(False)
    server.add_sockets([listening])
    return server
