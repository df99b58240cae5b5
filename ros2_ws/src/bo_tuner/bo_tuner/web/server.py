"""Serves the page to whoever has the token, read-only.

The token comes once in the address and then in a cookie, so that it stays out of the history and
of the Referer header. Requests for another host name are refused, since a page of a stranger could
send them by a name that it has resolve to this machine (DNS rebinding). Nothing can be changed: the
only method is GET.

Wherever the browser can wait, it does: ``/state`` answers once there is something new.
"""

import asyncio
import contextlib
import hmac
import json
import logging
import os
import socket
import threading
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, BinaryIO

from tornado.httpserver import HTTPServer
from tornado.web import Application, HTTPError, RequestHandler

from bo_tuner.errors import BoTunerError
from bo_tuner.web.address import HOST
from bo_tuner.web.sections import LiveSections, Part

LONGEST_WAIT = 20.0
"""Time [s] after which a request for news is answered without any."""
WATCHED = 30.0
"""Time [s] for which the sections are kept up to date after a request."""
LAST_LOOK = 20.0
"""Longest time [s] after the end of the run in which the page shows the result."""
LARGEST_REQUEST = 16_384
"""Size of a request's head [byte]."""
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "Server": "bo_tuner",
    "X-Content-Type-Options": "nosniff",
}


class LiveState:
    """What the page shows, with the version of each part; changed in the server's thread only.

    Parameters
    ----------
    sections
        Makes the sections.
    """

    def __init__(self, sections: LiveSections) -> None:
        self.sections = sections
        self.version = 0
        self.now: Mapping[str, Any] = {}
        self.parts: dict[str, tuple[int, Part]] = {}
        self.problem = ""
        self.complete = False
        self.shown = False
        self._watched_until = 0.0
        self._changed = asyncio.Event()
        self._due = asyncio.Event()
        # One thread: the sections share what they know.
        self._executor = ThreadPoolExecutor(1)

    async def call(self, function: Any, *arguments: Any) -> Any:
        """Call a function of `sections` in their thread."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._executor, function, *arguments)

    def take(self, now: Mapping[str, Any]) -> None:
        """Take what the run tells."""
        self.now = now
        self._due.set()
        self._publish()

    def watch(self) -> None:
        """Keep the sections up to date for a while."""
        self._watched_until = asyncio.get_running_loop().time() + WATCHED
        self._due.set()

    @property
    def watched(self) -> bool:
        """Whether somebody has looked of late."""
        return asyncio.get_running_loop().time() <= self._watched_until

    async def news(self, version: int) -> None:
        """Wait until there is something newer than a version, but not for long."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(LONGEST_WAIT):
                while self.version <= version:
                    await self._changed.wait()

    async def keep_up(self) -> None:
        """Make the sections anew whenever the run has come further and somebody looks."""
        made: object = None
        while True:
            await self._due.wait()
            self._due.clear()
            if not self.watched:
                continue
            reached = (self.now.get("trials"), self.now.get("phase"), self.now.get("ended"))
            if reached == made:
                continue
            made = reached
            ended = bool(self.now.get("ended"))
            # A run that was interrupted has no result to show.
            if not ended or self.now.get("verdict"):
                await self._make(ended=ended)
            if ended:
                self.complete = True
                self._publish()

    async def _make(self, *, ended: bool) -> None:
        names = []
        try:
            parts = self.sections.parts(ended=ended)
            while (part := await self.call(next, parts, None)) is not None:
                names.append(part.name)
                if part.name not in self.parts or self.parts[part.name][1] != part:
                    self.parts[part.name] = self.version + 1, part
                    self._publish()
            # Without those that no longer apply.
            self.parts = {name: self.parts[name] for name in names}
            problem = ""
        except BoTunerError as error:
            problem = f"The page cannot be brought up to date: {error}"
        if problem != self.problem:
            self.problem = problem
            self._publish()

    def _publish(self) -> None:
        self.version += 1
        self._changed.set()
        self._changed = asyncio.Event()


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

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        """Answer in a line of text."""
        _, error, _ = kwargs.get("exc_info", (None, None, None))
        said = error.log_message if isinstance(error, HTTPError) else ""
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code}: {said or self._reason}\n")


class Home(Page):
    """The page without sections."""

    async def get(self) -> None:
        """Put the token into a cookie, or answer with the page."""
        if self.get_query_argument("token", ""):
            self.set_cookie(self.cookie, self.token, path="/", httponly=True, samesite="Strict")
            self.redirect("/")
            return
        self.state.watch()
        self.finish(await self.state.call(self.state.sections.shell))


class State(Page):
    """What is new since a version: the present state, and the sections that have changed."""

    async def get(self) -> None:
        """Answer once there is something new."""
        state = self.state
        try:
            version = int(self.get_query_argument("after", "-1"))
        except ValueError:
            raise HTTPError(400, "after: expected a whole number") from None
        state.watch()
        await state.news(version)
        self.set_header("Content-Type", "application/json")
        self.write(
            json.dumps(
                {
                    "version": state.version,
                    "now": state.now,
                    "problem": state.problem,
                    "complete": state.complete,
                    "order": sorted(state.parts, key=lambda name: state.parts[name][1].place),
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


class TrialPage(Page):
    """The page of a trial."""

    async def get(self, number: str) -> None:
        """Answer with the page, if there is such a trial."""
        page = await self.state.call(self.state.sections.trial, int(number))
        if page is None:
            raise HTTPError(404, f"there is no trial {number} yet")
        self.finish(page)


class Missing(Page):
    """Any other address."""

    def get(self) -> None:
        """Answer that there is nothing, to who may know."""
        raise HTTPError(404, "there is no such page")


async def serve(listening: socket.socket, folder: str, token: str, told: BinaryIO) -> None:
    """Serve the page of a run until its end.

    Parameters
    ----------
    listening
        A socket that listens.
    folder
        The run folder.
    token
        What a reader must know.
    told
        Gives a line of JSON whenever the run has something to say, and ends with it.
    """
    state = LiveState(LiveSections(Path(folder)))
    shared = {"state": state, "token": token, "port": listening.getsockname()[1]}
    application = Application(
        [
            (r"/", Home, shared),
            (r"/state", State, shared),
            (r"/trials/([0-9]{1,9})", TrialPage, shared),
        ],
        default_handler_class=Missing,
        default_handler_args=shared,
        # A log of requests would hold the token.
        log_function=lambda handler: None,
    )
    server = HTTPServer(application, max_header_size=LARGEST_REQUEST, max_body_size=0)
    listening.setblocking(False)
    server.add_sockets([listening])
    keeping_up = asyncio.create_task(state.keep_up())
    over = asyncio.Event()
    loop = asyncio.get_running_loop()

    def listen() -> None:
        for line in told:
            loop.call_soon_threadsafe(state.take, json.loads(line))
        loop.call_soon_threadsafe(over.set)

    threading.Thread(target=listen, daemon=True).start()
    await over.wait()
    await _last_look(state)
    keeping_up.cancel()
    server.stop()
    # Without waiting for a section that is still being made.
    os._exit(0)


async def _last_look(state: LiveState) -> None:
    """Let those who look see the end of the run."""
    if not state.watched:
        return
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(LAST_LOOK):
            while not state.shown:
                await asyncio.sleep(0.02)
            # Other readers have asked for it, too.
            await asyncio.sleep(0.2)
