"""What the page of a run in progress shows, kept up to date while somebody reads it."""

import asyncio
import contextlib
import json
from collections.abc import Awaitable, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from functools import partial
from typing import Any

from bo_tuner.codec.reading import JSON, read
from bo_tuner.errors import BoTunerError
from bo_tuner.report.page import question_html
from bo_tuner.tuning.question import Asked
from bo_tuner.web.sections import LiveSections, Made, Part

LONGEST_WAIT = 20.0
"""Time [s] after which a request for news is answered without any."""
WATCHED = 30.0
"""Time [s] for which the parts are kept up to date after a request."""
QUICK = 0.5
"""Time [s] up to which parts that are made need no pause after them."""
REST = 4.0
"""Pause after all parts were made, in multiples of the time beyond `QUICK` that this took.

To read a long run takes seconds, and the run may need the processor.
"""


class LiveState:
    """What the page shows, with the version of each part; changed in the server's thread only.

    All parts are of one state of the run, that of the `stamp`.

    Attributes
    ----------
    parts
        By the name of a part, in their order, the version of its last change, and the part.
    best
        Which trial is the best within limits, by the number of trials known then; None if none is.
    stamp
        Which state of the run they show, in words.
    making, pages
        Threads of the parts, and of the page around them.
    """

    def __init__(self, sections: LiveSections) -> None:
        self.sections = sections
        self.version = 0
        self.now: Mapping[str, Any] = {}
        self.best: dict[int, int | None] = {}
        self._ahead: list[str] = []
        self._shown_question = (0, "", "")
        self.parts: dict[str, tuple[int, Part]] = {}
        self.stamp = ""
        self.problem = ""
        self.complete = False
        self.shown = False
        self.readers: set[object] = set()
        self._watched_until = 0.0
        self._changed = asyncio.Event()
        self._due = asyncio.Event()
        self._over = asyncio.Event()
        # One thread: what is made shares what it knows.
        self.making = ThreadPoolExecutor(1)
        # Another for the page, which need not wait for the parts.
        self.pages = ThreadPoolExecutor(1)

    async def call(self, thread: Executor, function: Any, *arguments: Any) -> Any:
        """Call a function in one of the threads."""
        return await asyncio.get_running_loop().run_in_executor(thread, function, *arguments)

    def take(self, message: Mapping[str, Any]) -> None:
        """Take a state of the run, or a part of a question that goes ahead of it."""
        if "ahead" in message:
            self._ahead[message["place"] :] = [message["ahead"]]
            return
        now = dict(message)
        # A state that is taken once more, with its end, has it as HTML already.
        if "text" in now.get("question", ()):
            now["question"] = self._question(**now["question"])
        if now.get("trials"):
            self.best[now["trials"]] = now.get("best_trial")
        self.now = now
        if now.get("ended"):
            self._over.set()
        self._due.set()
        self._publish()

    def _question(self, number: int, text: str) -> dict[str, object]:
        """Return a question as HTML, which is empty while nothing is asked."""
        whole, self._ahead = "".join((*self._ahead, text)), []
        if (number, whole) != self._shown_question[:2]:
            html = question_html(read(Asked, json.loads(whole), JSON)) if whole else ""
            self._shown_question = (number, whole, html)
        return {"number": number, "html": self._shown_question[2]}

    def watch(self) -> None:
        """Keep the parts up to date for a while."""
        self._watched_until = asyncio.get_running_loop().time() + WATCHED
        self._due.set()

    @property
    def watched(self) -> bool:
        """Whether somebody has read the page of late."""
        return asyncio.get_running_loop().time() <= self._watched_until

    async def news(self, version: int) -> None:
        """Wait until there is something newer than a version, but not for long."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(LONGEST_WAIT):
                while self.version <= version:
                    await self._changed.wait()

    async def keep_up(self) -> None:
        """Make the parts anew whenever the run has come further and somebody reads the page."""
        made: object = None
        while True:
            await self._due.wait()
            self._due.clear()
            reached = (self.now.get("trials"), self.now.get("phase"), self.now.get("ended"))
            if reached == made or not self.watched:
                continue
            made = reached
            if self._over.is_set():
                await self._finish()
            else:
                await self._and_rest(self._make(ended=False))
                # What has come meanwhile is due now.
                self._due.set()

    async def _finish(self) -> None:
        """Show the result; a run that was interrupted has none."""
        if self.now.get("verdict"):
            await self._make(ended=True)
        self.complete = True
        self._publish()

    async def _and_rest(self, making: Awaitable[object]) -> None:
        """Wait for what is made, and if that took long for a pause or until the run is over."""
        clock = asyncio.get_running_loop().time
        begin = clock()
        await making
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(REST * (clock() - begin - QUICK)):
                await self._over.wait()

    async def _make(self, *, ended: bool) -> None:
        """Make the parts and show them, all at once; after the end only those of the end."""
        try:
            make = partial(self.sections.made, dict(self.best), ended=ended)
            made = await self.call(self.making, make)
        except BoTunerError as error:
            self._show_problem(f"The page cannot be brought up to date: {error}")
        except Exception as error:
            # Unexpected, but the result is to be shown all the same.
            self._show_problem(
                f"The page cannot be brought up to date: {type(error).__name__}: {error}"
            )
        else:
            if ended or not self._over.is_set():
                self._show(made)

    def _show(self, made: Made) -> None:
        """Show parts in place of those before."""
        version = self.version + 1
        before, self.parts = self.parts, {}
        for part in made.parts:
            since, old = before.get(part.name, (version, None))
            self.parts[part.name] = (since if part == old else version, part)
        self.stamp, self.problem = made.stamp, ""
        self._publish()

    def _show_problem(self, problem: str) -> None:
        """Show a problem."""
        if problem != self.problem:
            self.problem = problem
            self._publish()

    def _publish(self) -> None:
        self.version += 1
        self._changed.set()
        self._changed = asyncio.Event()
