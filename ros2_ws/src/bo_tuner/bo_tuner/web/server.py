"""Serves the page of a run in progress, and beside it those of the other runs.

Wherever the browser can wait, it does: ``/state`` answers once there is something new.
"""

import asyncio
import contextlib
import json
import os
import re
import secrets
import socket
import threading
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, BinaryIO

from tornado.web import HTTPError

from bo_tuner.errors import BoTunerError
from bo_tuner.text import printable
from bo_tuner.tuning.question import Reply
from bo_tuner.web.page import Access, Page, Route, new_control_token, start_server
from bo_tuner.web.request import WORDS
from bo_tuner.web.run_pages import run_routes
from bo_tuner.web.runs import Runs
from bo_tuner.web.sections import LiveSections
from bo_tuner.web.state import LiveState

PAGE = secrets.token_hex(8)
"""Distinguishes one run's page from that of the next on the same port."""
LAST_LOOK = 20.0
"""Longest time [s] after the end of the run in which the page shows the result."""
LEFT = 2.0
"""Time [s] without a request for news after which all readers have left."""
NO_PIPE = -1


class LiveHandler(Page):
    """Base of what is about the run in progress."""

    def initialize(self, **shared: Any) -> None:
        """Take the state of the run, too."""
        super().initialize(**shared)
        self.state: LiveState = shared["state"]


class Home(LiveHandler):
    """The page without its parts."""

    async def get(self) -> None:
        """Put the token into a cookie, or answer with the page."""
        if self.enter():
            return
        self.state.watch()
        state = self.state
        try:
            page = await state.call(state.pages, state.sections.shell, self.access.control)
        except BoTunerError as error:
            # There is a record once the nodes are up.
            self.set_status(503)
            self.set_header("Refresh", "1")
            self.set_header("Content-Type", "text/plain; charset=utf-8")
            page = f"The page comes as soon as it can be made: {error}\n"
        self.finish(page)


class State(LiveHandler):
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


class RequestToRun(LiveHandler):
    """A request to pause, continue or end the run, or an answer to what it asks."""

    def initialize(self, **shared: Any) -> None:
        """Take the pipe to the run, too."""
        super().initialize(**shared)
        self.requests: int = shared["requests"]

    def post(self, name: str) -> None:
        """Pass the request on, if it is the page that asks.

        An answer has the number of its question: the one that the reader has seen.
        """
        self.check_control()
        words = [name]
        if name in list(Reply):
            number = self.get_query_argument("question", "")
            if re.fullmatch(r"[0-9]{1,9}", number) is None:
                raise HTTPError(400, "question: expected a whole number")
            words += [number, self.request.remote_ip or "-"]
        try:
            # A pipe takes a short line whole (POSIX, write).
            os.write(self.requests, f"{' '.join(words)}\n".encode())
        except BrokenPipeError:
            raise HTTPError(409, "the run has ended") from None
        self.set_status(202)


async def serve(listening: socket.socket, settings: Mapping[str, Any], steps: BinaryIO) -> None:
    """Serve the page of a run until its end."""
    folder, control = Path(settings["folder"]), settings.get("control", NO_PIPE)
    access = Access(
        settings["token"],
        settings["host"],
        listening.getsockname()[1],
        "" if control == NO_PIPE else new_control_token(),
    )
    state = LiveState(LiveSections(folder))
    shared = {"state": state}
    of_run: list[Route] = [
        (r"/", Home, shared),
        (r"/state", State, shared),
        (rf"/requests/({'|'.join(WORDS)})", RequestToRun, shared | {"requests": control}),
    ]
    # A thread of their own, so that a comparison does not hold up the page of the run.
    runs = Runs(folder.parent, folder.name)
    server = start_server(listening, access, of_run + run_routes(runs, ThreadPoolExecutor(1)))
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
