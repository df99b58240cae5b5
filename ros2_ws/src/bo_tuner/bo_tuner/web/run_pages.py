"""Serves the pages about the runs in a folder: beside a run in progress, and by themselves.

Nothing of a run can be changed; where it is allowed, its page may start commands that it shows.
Files are given as downloads, never shown: what a stranger's run has named HTML would else be a page
of ours.
"""

import asyncio
import contextlib
import json
import os
import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import quote

from tornado.iostream import StreamClosedError
from tornado.web import HTTPError

from bo_tuner.interruption import LOOK_AROUND, Interruption
from bo_tuner.report.content import Forecast
from bo_tuner.storage.run_files import open_file
from bo_tuner.web.address import Address
from bo_tuner.web.page import Access, Page, Route, new_control_token, start_server
from bo_tuner.web.places import COMPARED, NEWS, RUNS, STARTED, STOP
from bo_tuner.web.runs import MOST_COMPARED, Runs
from bo_tuner.web.started import RunningError, Started

NO_RUN = "there is no such run here"
NO_TRIAL = "there is no such trial here"
NO_FILE = "there is no such file here"
NOT_SHOWN = "the page of this run has no such command to start"
PIECE = 1_000_000
"""Of a file that is sent at once [byte]."""


class RunsHandler(Page):
    """Base of the pages about the runs in a folder."""

    def initialize(self, **shared: Any) -> None:
        """Take what makes these pages, and the thread in which it may be used."""
        super().initialize(**shared)
        self.runs: Runs = shared["runs"]
        self.thread: ThreadPoolExecutor = shared["thread"]

    def decode_argument(self, value: bytes, name: str | None = None) -> str:
        """Take folders and files in a path as the system has them, which need not be UTF-8."""
        return super().decode_argument(value, name) if name else os.fsdecode(value)


class Entrance(RunsHandler):
    """Where the address that was printed leads to, without a run in progress."""

    def get(self) -> None:
        """Put the token into a cookie, and go on to the list."""
        if not self.enter():
            self.redirect(RUNS)


class RunsPage(RunsHandler):
    """The list of runs."""

    async def get(self) -> None:
        """Answer with a page of the list."""
        await self.answer(self.runs.listing)

    async def answer(self, make: Callable[[int], str | None]) -> None:
        """Answer with what is made of the page that is asked for."""
        page = self.get_query_argument("page", "0")
        if not page.isascii() or not page.isdecimal() or len(page) > 9:
            raise HTTPError(400, "page: expected a whole number")
        missing = "there is no such page of the list"
        self.finish(await self.made(missing, self.thread, make, int(page)))


class RunsNews(RunsPage):
    """What a page of the list has now, which the page asks for from time to time."""

    async def get(self) -> None:
        """Answer with the list without what is around it."""
        await self.answer(self.runs.news)


class RunsTable(RunsHandler):
    """The list of runs as a file for a spreadsheet."""

    async def get(self) -> None:
        """Answer with all runs as CSV."""
        text = await self.made(NO_RUN, self.thread, self.runs.table)
        _offer(self, "runs.csv")
        self.finish(text.encode("utf-8", "replace"))


class RunPage(RunsHandler):
    """The report of a run."""

    async def get(self, name: str) -> None:
        """Answer with the report, if there is such a run."""
        self.finish(await self.made(NO_RUN, self.thread, self.runs.report, name))


class TrialPage(RunsHandler):
    """The page of a trial."""

    async def get(self, name: str, number: str) -> None:
        """Answer with the page, if there is such a trial."""
        page = await self.made(NO_TRIAL, self.thread, self.runs.trial, name, int(number))
        self.finish(page)


class TwoTrials(RunsHandler):
    """Two trials of a run side by side."""

    async def get(self, name: str) -> None:
        """Answer with the comparison."""
        given = self.get_query_arguments("trial")
        if len(given) != 2 or not all(re.fullmatch(r"[0-9]{1,9}", number) for number in given):
            raise HTTPError(400, "trial: expected the numbers of two trials; go back")
        numbers = [int(number) for number in given]
        page = await self.made(NO_TRIAL, self.thread, self.runs.two_trials, name, numbers)
        self.finish(page)


class ForecastOf(RunsHandler):
    """What the models predict for values of a run's parameters."""

    async def get(self, name: str) -> None:
        """Answer with predictions in JSON."""
        asked = self.request.query_arguments
        try:
            values = {key: float(given[-1]) for key, given in asked.items() if key != "token"}
        except ValueError:
            raise HTTPError(400, "expected numbers") from None
        missing = "there is nothing to predict for these values"
        found: Forecast = await self.made(missing, self.thread, self.runs.forecast, name, values)
        self.set_header("Content-Type", "application/json")
        self.finish(json.dumps(asdict(found)))


class ComparisonPage(RunsHandler):
    """Runs side by side."""

    async def get(self) -> None:
        """Answer with the comparison."""
        names = list(dict.fromkeys(self.get_query_arguments("run")))
        if not 2 <= len(names) <= MOST_COMPARED:
            raise HTTPError(
                400, f"choose 2 to {MOST_COMPARED} runs to compare, found {len(names)}; go back"
            )
        self.finish(await self.made(NO_RUN, self.thread, self.runs.compared, names))


class RunFile(RunsHandler):
    """A file of a run, to download."""

    async def get(self, name: str, path: str) -> None:
        """Answer with the file, piece by piece."""
        found: Path = await self.made(NO_FILE, self.thread, self.runs.file, name, path)
        try:
            file = os.fdopen(open_file(found, os.O_RDONLY), "rb")
        except OSError as error:
            raise HTTPError(409, "%s cannot be read: %s", path, error.strerror) from None
        _offer(self, found.name)
        # A reader may break it off.
        with file, contextlib.suppress(StreamClosedError):
            while piece := file.read(PIECE):
                self.write(piece)
                await self.flush()


class StartHandler(Page):
    """Base of what is about the command that a page has started."""

    def initialize(self, **shared: Any) -> None:
        """Take what starts commands, too."""
        super().initialize(**shared)
        self.started: Started = shared["started"]


class Start(RunsHandler, StartHandler):
    """A request to start a command that the page of a run shows."""

    async def post(self, name: str) -> None:
        """Start it, if it is the page that asks."""
        self.check_control()
        command = self.request.body.decode("utf-8", "replace")
        words = await self.made(NOT_SHOWN, self.thread, self.runs.to_start, name, command)
        try:
            await self.started.start(words, self.request.remote_ip or "-")
        except RunningError as error:
            raise HTTPError(409, "%s", error) from None
        self.set_status(202)


class StartedNews(StartHandler):
    """What the command has printed."""

    async def get(self) -> None:
        """Answer once there is more than at a version."""
        version = self.get_query_argument("after", "-1")
        if re.fullmatch(r"-1|[0-9]{1,9}", version) is None:
            raise HTTPError(400, "after: expected a whole number")
        self.set_header("Content-Type", "application/json")
        self.finish(json.dumps(await self.started.news(int(version))))


class Stop(StartHandler):
    """A request to end the command."""

    def post(self) -> None:
        """Ask it to end, if it is the page that asks."""
        self.check_control()
        self.started.stop()
        self.set_status(202)


def run_routes(runs: Runs, thread: ThreadPoolExecutor) -> list[Route]:
    """Return the routes of the pages about runs, which are made in a thread."""
    shared = {"runs": runs, "thread": thread}
    pages: list[tuple[str, type[RunsHandler]]] = [
        (RUNS, RunsPage),
        (NEWS, RunsNews),
        (r"/runs\.csv", RunsTable),
        (r"/runs/([^/]+)", RunPage),
        (r"/runs/([^/]+)/trials/([0-9]{1,9})", TrialPage),
        (rf"/runs/([^/]+)/trials/{COMPARED}", TwoTrials),
        (r"/runs/([^/]+)/forecast", ForecastOf),
        (r"/runs/([^/]+)/files/(.+)", RunFile),
        (r"/compare", ComparisonPage),
    ]
    return [(pattern, handler, shared) for pattern, handler in pages]


def serve_runs(
    address: Address, folder: Path, interruption: Interruption, started: Started | None = None
) -> NoReturn:
    """Serve the runs in a folder until the end is asked for; pages may start commands if given."""
    asyncio.run(_serve(address, folder, interruption, started))


async def _serve(
    address: Address, folder: Path, interruption: Interruption, started: Started | None
) -> NoReturn:
    control = "" if started is None else new_control_token()
    access = Access(address.token, address.host, address.port, control)
    thread = ThreadPoolExecutor(1)
    runs = Runs(folder, control=control)
    shared = {"runs": runs, "thread": thread, "started": started}
    routes: list[Route] = [(r"/", Entrance, shared), *run_routes(runs, thread)]
    if started is not None:
        routes += [
            (r"/runs/([^/]+)/start", Start, shared),
            (STARTED, StartedNews, shared),
            (STOP, Stop, shared),
        ]
    server = start_server(address.socket, access, routes)
    try:
        while True:
            interruption.check()
            await asyncio.sleep(LOOK_AROUND)
    finally:
        server.stop()
        thread.shutdown(wait=False, cancel_futures=True)
        if started is not None:
            await started.close()


def _offer(page: Page, name: str) -> None:
    """Let a browser keep an answer as a file."""
    page.set_header("Content-Type", "application/octet-stream")
    quoted = quote(os.fsencode(name))
    page.set_header("Content-Disposition", f"attachment; filename*=UTF-8''{quoted}")
