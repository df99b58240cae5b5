"""Serves the page to whoever has the token.

The token comes once in the address and then in a cookie, so that it stays out of the history and
of the Referer header. Requests for another host name are refused, since a page of a stranger could
send them by a name that it has resolve to this machine (DNS rebinding). Nothing can be changed,
unless the run takes requests: each of these must come from the page itself, by its Origin, and with
a token of its own in a header, which only who can read the page has.

Wherever the browser can wait, it does: ``/state`` answers once there is something new.
"""

import asyncio
import contextlib
import hmac
import json
import logging
import os
import secrets
import socket
import threading
from collections.abc import Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, BinaryIO

from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream
from tornado.web import Application, HTTPError, RequestHandler

from bo_tuner.errors import BoTunerError
from bo_tuner.text import printable
from bo_tuner.web.address import HOST
from bo_tuner.web.request import Request
from bo_tuner.web.runs import MOST_COMPARED, Runs
from bo_tuner.web.sections import LiveSections
from bo_tuner.web.state import LiveState

PAGE = secrets.token_hex(8)
"""Distinguishes one run's page from that of the next on the same port."""
LAST_LOOK = 20.0
"""Longest time [s] after the end of the run in which the page shows the result."""
LEFT = 2.0
"""Time [s] without a request for news after which all readers have left."""
LARGEST_REQUEST = 16_384
"""Size of a request's head [byte]."""
LONGEST_REQUEST = 5.0
"""Time [s] in which the head of a request must be there: a browser sends it at once."""
MOST_CONNECTIONS = 100
"""Connections at a time, those of some ten browsers; each takes a file descriptor of few."""
NO_RUN = "there is no such run here"
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "Server": "bo_tuner",
    "X-Content-Type-Options": "nosniff",
}


class Page(RequestHandler):
    """Base of all pages: checks host and token."""

    def initialize(self, state: LiveState, token: str, port: int) -> None:
        """Take what the pages share."""
        self.state = state
        self.token = token
        self.port = port

    def set_default_headers(self) -> None:
        """Set the headers of every answer, errors included."""
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        """Refuse who does not know the token, and who asks for another host."""
        if self.request.host not in {f"{HOST}:{self.port}", f"localhost:{self.port}"}:
            raise HTTPError(403, "the host name is not that of this page")
        given = self.get_query_argument("token", "") or self.get_cookie(self.cookie, "") or ""
        if not hmac.compare_digest(given.encode(), self.token.encode()):
            raise HTTPError(403, "open the address that tune has printed, with its token")

    @property
    def cookie(self) -> str:
        """Name of the cookie; cookies of one host are shared by all its ports."""
        return f"bo_tuner_{self.port}"

    def log_exception(self, *error: Any) -> None:
        """Log what is a fault of ours, without the address: it may hold the token."""
        if not isinstance(error[1], HTTPError):
            logging.getLogger(__name__).error("%s", self.request.path, exc_info=error)

    async def finish_with(self, missing: str, thread: Executor, make: Any, *arguments: Any) -> None:
        """Answer with a page that is made in one of the threads, or that it is `missing`."""
        try:
            page = await self.state.call(thread, make, *arguments)
        except BoTunerError as error:
            raise HTTPError(409, str(error)) from None
        if page is None:
            raise HTTPError(404, missing)
        self.finish(page)

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        """Answer in a line of text."""
        _, error, _ = kwargs.get("exc_info", (None, None, None))
        said = ""
        if isinstance(error, HTTPError) and error.log_message:
            said = error.log_message % error.args
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code}: {said or self._reason}\n")


class Home(Page):
    """The page without its parts."""

    async def get(self) -> None:
        """Put the token into a cookie, or answer with the page."""
        if self.get_query_argument("token", ""):
            self.set_cookie(self.cookie, self.token, path="/", httponly=True, samesite="Strict")
            self.redirect("/")
            return
        self.state.watch()
        state = self.state
        try:
            page = await state.call(state.pages, state.sections.shell, state.control)
        except BoTunerError as error:
            # There is a record once the nodes are up.
            self.set_status(503)
            self.set_header("Refresh", "1")
            self.set_header("Content-Type", "text/plain; charset=utf-8")
            page = f"The page comes as soon as it can be made: {error}\n"
        self.finish(page)


class State(Page):
    """What is new since a version: the present state, and the parts that have changed."""

    async def get(self) -> None:
        """Answer once there is something new."""
        state = self.state
        try:
            version = int(self.get_query_argument("after", "-1"))
        except ValueError:
            raise HTTPError(400, "after: expected a whole number") from None
        state.watch()
        state.readers.add(self)
        try:
            await state.news(version)
        finally:
            state.readers.discard(self)
        self.set_header("Content-Type", "application/json")
        self.write(
            json.dumps(
                {
                    "page": PAGE,
                    "version": state.version,
                    "now": state.now,
                    "problem": printable(state.problem),
                    "complete": state.complete,
                    "stamp": state.stamp,
                    "order": {name: part.title for name, (_, part) in state.parts.items()},
                    "sections": {
                        name: part.html
                        for name, (since, part) in state.parts.items()
                        if since > version
                    },
                }
            )
        )
        await self.flush()
        state.shown = state.complete

    def on_connection_close(self) -> None:
        """Note that a reader has left while it waited."""
        self.state.readers.discard(self)


class TrialPage(Page):
    """The page of a trial."""

    async def get(self, number: str) -> None:
        """Answer with the page, if there is such a trial."""
        state, missing = self.state, f"there is no trial {number} yet"
        await self.finish_with(missing, state.models, state.sections.trial, int(number))


class RunsPage(Page):
    """The list of runs."""

    async def get(self) -> None:
        """Answer with the list."""
        self.finish(await self.state.call(self.state.others, self.state.runs.listing))


class RunPage(Page):
    """The report of another run."""

    async def get(self, name: str) -> None:
        """Answer with the report, if there is such a run."""
        state = self.state
        await self.finish_with(NO_RUN, state.others, state.runs.report, name)


class ComparisonPage(Page):
    """Runs side by side."""

    async def get(self) -> None:
        """Answer with the comparison."""
        names = list(dict.fromkeys(self.get_query_arguments("run")))
        if not 2 <= len(names) <= MOST_COMPARED:
            raise HTTPError(
                400, f"choose 2 to {MOST_COMPARED} runs to compare, found {len(names)}; go back"
            )
        state = self.state
        await self.finish_with(NO_RUN, state.others, state.runs.compared, names)


class RequestToRun(Page):
    """A request to pause, continue or end the run."""

    def post(self, name: str) -> None:
        """Pass the request on, if it is the page that asks."""
        state = self.state
        if state.requests is None:
            raise HTTPError(403, "the page is read-only; tune --web-control allows requests")
        if self.request.headers.get("Origin", "") != f"http://{self.request.host}":
            raise HTTPError(403, "the request is not from this page")
        given = self.request.headers.get("X-Control-Token", "")
        if not hmac.compare_digest(given.encode(), state.control.encode()):
            raise HTTPError(403, "the request is not from this page, or from one of an earlier run")
        try:
            # A pipe takes a short line whole (POSIX, write).
            os.write(state.requests, f"{Request(name)}\n".encode())
        except BrokenPipeError:
            raise HTTPError(409, "the run has ended") from None
        self.set_status(202)


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


async def serve(listening: socket.socket, settings: Mapping[str, Any], steps: BinaryIO) -> None:
    """Serve the page of a run until its end.

    Parameters
    ----------
    listening
        A socket that listens.
    settings
        The run `folder`, the `token` that a reader must know, and, if the run takes requests, the
        pipe for them as `control`.
    steps
        Gives a line of JSON whenever the run has something to say, and ends with it.
    """
    folder = Path(settings["folder"])
    runs = Runs(folder.parent, folder.name)
    state = LiveState(LiveSections(folder), runs, settings.get("control"))
    shared = {"state": state, "token": settings["token"], "port": listening.getsockname()[1]}
    application = Application(
        [
            (r"/", Home, shared),
            (r"/state", State, shared),
            (r"/trials/([0-9]{1,9})", TrialPage, shared),
            (r"/runs", RunsPage, shared),
            (r"/runs/([^/]+)", RunPage, shared),
            (r"/compare", ComparisonPage, shared),
            (rf"/requests/({'|'.join(Request)})", RequestToRun, shared),
        ],
        default_handler_class=Missing,
        default_handler_args=shared,
        # A log of requests would hold the token.
        log_function=lambda handler: None,
    )
    server = Server(
        application,
        max_header_size=LARGEST_REQUEST,
        max_body_size=0,
        idle_connection_timeout=LONGEST_REQUEST,
    )
    listening.setblocking(False)
    server.add_sockets([listening])
    keeping_up = asyncio.create_task(state.keep_up())
    over = asyncio.Event()
    loop = asyncio.get_running_loop()

    def listen() -> None:
        for line in steps:
            loop.call_soon_threadsafe(state.take, json.loads(line))
        loop.call_soon_threadsafe(end)

    def end() -> None:
        # A run that was killed has not said so.
        if not state.now.get("ended"):
            state.take({**state.now, "ended": True, "verdict": ""})
        over.set()

    threading.Thread(target=listen, daemon=True).start()
    await over.wait()
    await _last_look(state)
    keeping_up.cancel()
    server.stop()
    # Without waiting for what is still being made.
    os._exit(0)


async def _last_look(state: LiveState) -> None:
    """Let readers of the page see the end of the run."""
    if not state.watched:
        return
    loop = asyncio.get_running_loop()
    present = loop.time()
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(LAST_LOOK):
            while not state.shown:
                # Between two requests a reader is still there.
                present = loop.time() if state.readers else present
                if loop.time() - present > LEFT:
                    return
                await asyncio.sleep(0.02)
            # Other readers have asked for it, too.
            await asyncio.sleep(0.2)
