"""What the page of a run in progress shows, kept up to date while somebody looks."""

import asyncio
import contextlib
import secrets
from collections.abc import Awaitable, Callable, Iterator, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import Any

from bo_tuner.errors import BoTunerError
from bo_tuner.web.address import TOKEN_BYTES
from bo_tuner.web.runs import Runs
from bo_tuner.web.sections import LiveSections, Part

LONGEST_WAIT = 20.0
"""Time [s] after which a request for news is answered without any."""
WATCHED = 30.0
"""Time [s] for which the sections are kept up to date after a request."""
QUICK = 0.5
"""Time [s] up to which sections that are made need no pause after them."""
REST = 4.0
"""Pause after all sections were made, in multiples of the time beyond `QUICK` that this took.

The models of many trials take seconds, and the run may need the processor. A trial that takes
longer than that is in the models at once.
"""
SHORT_REST = 1.0
"""As `REST`, of the sections that show what a trial was."""


class LiveState:
    """What the page shows, with the version of each part; changed in the server's thread only.

    Parameters
    ----------
    sections
        Makes the sections.
    runs
        Makes the pages about other runs.
    requests
        Pipe to the run, which takes requests from it; None if it takes none.

    Attributes
    ----------
    models, tables, others
        Threads of the sections with models, of those without, and of the pages about other runs.
    """

    def __init__(self, sections: LiveSections, runs: Runs, requests: int | None) -> None:
        self.sections = sections
        self.runs = runs
        self.requests = requests
        self.control = "" if requests is None else secrets.token_urlsafe(TOKEN_BYTES)
        self.version = 0
        self.now: Mapping[str, Any] = {}
        self.parts: dict[str, tuple[int, Part]] = {}
        self.problem = ""
        self.complete = False
        self.shown = False
        self.readers: set[object] = set()
        self._watched_until = 0.0
        self._changed = asyncio.Event()
        self._due = asyncio.Event()
        self._over = asyncio.Event()
        # One thread: the sections share what they know.
        self.models = ThreadPoolExecutor(1)
        # Another for those that need not wait for the models.
        self.tables = ThreadPoolExecutor(1)
        # Another, so that a comparison does not hold up the page of the run.
        self.others = ThreadPoolExecutor(1)

    async def call(self, thread: Executor, function: Any, *arguments: Any) -> Any:
        """Call a function in one of the threads."""
        return await asyncio.get_running_loop().run_in_executor(thread, function, *arguments)

    def take(self, now: Mapping[str, Any]) -> None:
        """Take what the run tells."""
        self.now = now
        if now.get("ended"):
            self._over.set()
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
        behind = False
        others = asyncio.create_task(asyncio.sleep(0.0))
        while True:
            await self._due.wait()
            self._due.clear()
            if not self.watched:
                continue
            reached = (self.now.get("trials"), self.now.get("phase"), self.now.get("ended"))
            if self._over.is_set():
                await asyncio.wait([others])
                if reached != made:
                    made = reached
                    await self._finish()
                continue
            if reached != made:
                made, behind = reached, True
                first = self._make(self.tables, self.sections.preliminary())
                await self._and_rest(first, SHORT_REST)
            # The end may have come meanwhile; the result need not wait for what it replaces.
            if behind and others.done() and not self._over.is_set():
                behind = False
                others = asyncio.create_task(self._make_all())

    async def _finish(self) -> None:
        """Show the result; a run that was interrupted has none."""
        if self.now.get("verdict"):
            await self._make_whole(self.sections.parts(ended=True), last=True)
        self.complete = True
        self._publish()

    async def _make_all(self) -> None:
        """Make all sections of a run that goes on, and rest."""
        await self._and_rest(self._make_whole(self.sections.parts(ended=False)), REST)
        # What has come meanwhile is due now.
        self._due.set()

    async def _and_rest(self, making: Awaitable[object], factor: float) -> None:
        """Wait for what is made, and if that took long for a pause or until the run is over."""
        clock = asyncio.get_running_loop().time
        begin = clock()
        await making
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(factor * (clock() - begin - QUICK)):
                await self._over.wait()

    async def _make_whole(self, parts: Iterator[Part], *, last: bool = False) -> None:
        """Show the parts of the page, and no others; once the run is over, only the `last` ones."""
        names = await self._make(self.models, parts, lambda: self._over.is_set() and not last)
        if names is not None:
            self.parts = {name: self.parts[name] for name in names}
            self._tell("")

    async def _make(
        self,
        thread: Executor,
        parts: Iterator[Part],
        stop: Callable[[], bool] = lambda: False,
    ) -> list[str] | None:
        """Show parts as they are ready, and return their names; None if not all were made."""
        names = []
        try:
            while (part := await self.call(thread, next, parts, None)) is not None:
                if stop():
                    return None
                names.append(part.name)
                self._show(part)
        except BoTunerError as error:
            self._tell(f"The page cannot be brought up to date: {error}")
            return None
        except Exception as error:
            # Unexpected, but the other sections, and the result, are to be shown all the same.
            self._tell(f"The page cannot be brought up to date: {type(error).__name__}: {error}")
            return None
        return names

    def _show(self, part: Part) -> None:
        """Show a part, unless one of more trials is there already."""
        version, shown = self.parts.get(part.name, (-1, None))
        if shown is not None and part.trials < shown.trials:
            return
        new = shown is None or part.html != shown.html
        self.parts[part.name] = (self.version + 1 if new else version, part)
        if new:
            self._publish()

    def _tell(self, problem: str) -> None:
        """Tell of a problem, or with an empty text that there is none any more."""
        if problem != self.problem:
            self.problem = problem
            self._publish()

    def _publish(self) -> None:
        self.version += 1
        self._changed.set()
        self._changed = asyncio.Event()
