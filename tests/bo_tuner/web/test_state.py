"""What the page shows first, and what it makes when; the sections are made by the tests."""

import asyncio
import threading
from types import SimpleNamespace

import pytest
from waiting import DEADLINE

from bo_tuner.errors import BoTunerError
from bo_tuner.web import state as state_module
from bo_tuner.web.sections import Part
from bo_tuner.web.state import LiveState


class Sections:
    """Sections of a run with so many trials; the models of it take until `fitted` is set."""

    def __init__(self):
        self.trials = 1
        self.fitted = threading.Event()
        self.made = []

    def preliminary(self):
        self.made.append(("first", self.trials))
        yield self.table(self.trials)

    def parts(self, *, ended):
        trials = self.trials
        self.made.append(("result" if ended else "all", trials))
        assert self.fitted.wait(DEADLINE)
        yield self.table(trials)
        yield Part("answer", 0, f"{'result' if ended else 'best'} of {trials}", trials)
        if trials < 3:
            yield Part("early", 2, "few trials", trials)

    def table(self, trials):
        return Part("table", 1, f"{trials} trials", trials)


class Page:
    """A page of such a run that somebody looks at."""

    def __init__(self):
        self.sections = Sections()
        self.state = LiveState(self.sections, SimpleNamespace(), None)
        self.state.watch()

    def advance(self, trials, **now):
        self.sections.trials = trials
        self.state.take({"trials": trials, **now})

    def shown(self):
        return {name: part.html for name, (_, part) in self.state.parts.items()}

    async def until(self, condition):
        async with asyncio.timeout(DEADLINE):
            while not condition():
                await asyncio.sleep(0.001)


@pytest.fixture
def play():
    """Function that runs a coroutine function with a page that is kept up to date."""

    async def played(story):
        page = Page()
        keeping_up = asyncio.create_task(page.state.keep_up())
        try:
            await story(page)
        finally:
            page.sections.fitted.set()
            keeping_up.cancel()

    return lambda story: asyncio.run(played(story))


def test_a_trial_shows_before_the_models_are_fitted(play):
    async def story(page):
        page.advance(1)
        await page.until(lambda: ("all", 1) in page.sections.made)
        page.advance(2)
        await page.until(lambda: page.shown() == {"table": "2 trials"})
        # Those of the models with one trial come now, but its table does not come back.
        page.sections.fitted.set()
        await page.until(lambda: "answer" in page.shown())
        assert page.shown()["table"] == "2 trials"

    play(story)


def test_sections_rest_until_the_run_is_over(play, monkeypatch):
    monkeypatch.setattr(state_module, "REST", 1e9)
    monkeypatch.setattr(state_module, "QUICK", 0.0)

    async def story(page):
        page.sections.fitted.set()
        page.advance(1)
        await page.until(lambda: "answer" in page.shown())
        for trials in (2, 3):
            page.advance(trials)
            await page.until(lambda: page.shown()["table"] == f"{trials} trials")  # noqa: B023
        assert page.shown()["answer"] == "best of 1"
        page.advance(4, ended=True, verdict="kept")
        await page.until(lambda: page.state.complete)
        assert page.shown() == {"table": "4 trials", "answer": "result of 4"}
        assert [made for made in page.sections.made if made[0] != "first"] == [
            ("all", 1),
            ("result", 4),
        ]

    play(story)


def test_after_a_rest_all_that_has_come_meanwhile_is_shown(play, monkeypatch):
    monkeypatch.setattr(state_module, "REST", 1.0)

    async def story(page):
        page.sections.fitted.set()
        for trials in range(1, 6):
            page.advance(trials)
        await page.until(lambda: page.shown().get("answer") == "best of 5")
        await page.until(lambda: "early" not in page.shown())

    play(story)


def test_a_run_that_is_interrupted_has_no_result(play):
    async def story(page):
        page.sections.fitted.set()
        page.advance(1)
        await page.until(lambda: "answer" in page.shown())
        page.advance(2, ended=True)
        await page.until(lambda: page.state.complete)
        assert page.shown()["answer"] == "best of 1"

    play(story)


def test_a_record_that_cannot_be_read_is_told_of_until_it_can(play, monkeypatch):
    async def story(page):
        def unreadable(*, ended):
            raise BoTunerError("no disk")
            yield

        page.sections.fitted.set()
        with monkeypatch.context() as patch:
            patch.setattr(page.sections, "parts", unreadable)
            page.advance(1)
            await page.until(lambda: page.state.problem.endswith("no disk"))
        page.advance(2)
        await page.until(lambda: page.shown().get("answer") == "best of 2")
        await page.until(lambda: page.state.problem == "")

    play(story)


@pytest.mark.parametrize("name", ["preliminary", "parts"])
def test_an_unexpected_error_holds_up_neither_the_rest_nor_the_result(play, monkeypatch, name):
    async def story(page):
        def broken(**_):
            raise ValueError("a matrix is singular")
            yield

        with monkeypatch.context() as patch:
            patch.setattr(page.sections, name, broken)
            page.advance(1)
            await page.until(
                lambda: page.state.problem.endswith("ValueError: a matrix is singular")
            )
        # Not before: the problem is over as soon as all sections are made.
        page.sections.fitted.set()
        page.advance(2)
        await page.until(lambda: page.shown().get("answer") == "best of 2")
        page.advance(2, ended=True, verdict="kept")
        await page.until(lambda: page.state.complete)
        assert page.shown()["answer"] == "result of 2"

    play(story)
