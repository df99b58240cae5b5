"""What the page of a run in progress shows, kept up to date while somebody looks."""

import asyncio
import contextlib
import secrets
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from bo_tuner.errors import BoTunerError
from bo_tuner.web.address import TOKEN_BYTES
from bo_tuner.web.runs import Runs
from bo_tuner.web.sections import LiveSections, Part

LONGEST_WAIT = 20.0
"""Time [s] after which a request for news is answered without any."""
WATCHED = 30.0
"""Time [s] for which the sections are kept up to date after a request."""


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
        # One thread: the sections share what they know.
        self._executor = ThreadPoolExecutor(1)
        # Another, so that a comparison does not hold up the page of the run.
        self._aside = ThreadPoolExecutor(1)

    async def call(self, function: Any, *arguments: Any) -> Any:
        """Call a function of `sections` in their thread."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._executor, function, *arguments)

    async def call_aside(self, function: Any, *arguments: Any) -> Any:
        """Call a function of `runs` in their thread."""
        return await asyncio.get_running_loop().run_in_executor(self._aside, function, *arguments)

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
