"""What the page shows, and what it makes when; the parts are made by the tests."""

import asyncio
import threading

import pytest
from waiting import DEADLINE

from bo_tuner.errors import BoTunerError
from bo_tuner.web import state as state_module
from bo_tuner.web.sections import Made, Part
from bo_tuner.web.state import LiveState


class Sections:
    """Parts of a run with so many trials; the models of it take until `fitted` is set."""

    def __init__(self):
        self.trials = 1
        self.fitted = threading.Event()
        self.calls = []

    def made(self, best, *, ended):
        trials = self.trials
        self.calls.append(("result" if ended else "all", trials))
        assert self.fitted.wait(DEADLINE)
        parts = [Part("answer", f"{'result' if ended else 'best'} of {trials}")]
        parts.append(Part("trials", f"{trials} trials"))
        if trials < 3:
            parts.append(Part("early", "few trials"))
        return Made(tuple(parts), f"As of {trials} trials")


class Page:
    """A page of such a run that somebody looks at."""

    def __init__(self):
        self.sections = Sections()
        self.state = LiveState(self.sections)
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


def test_all_that_is_shown_is_of_one_state(play, monkeypatch):
    """Whatever the run does while the parts are made, and while others are shown."""

    async def story(page):
        states = set()
        publish = page.state._publish

        def noted():
            states.add((page.state.stamp, *page.shown().values()))
            publish()

        monkeypatch.setattr(page.state, "_publish", noted)
        page.advance(1)
        await page.until(lambda: ("all", 1) in page.sections.calls)
        page.advance(2)
        page.sections.fitted.set()
        await page.until(lambda: page.shown().get("answer") == "best of 2")
        page.advance(3)
        await page.until(lambda: page.shown().get("answer") == "best of 3")
        assert states == {
            ("",),
            ("As of 1 trials", "best of 1", "1 trials", "few trials"),
            ("As of 2 trials", "best of 2", "2 trials", "few trials"),
            ("As of 3 trials", "best of 3", "3 trials"),
        }

    play(story)


def test_what_has_not_changed_is_not_sent_again(play):
    async def story(page):
        page.sections.fitted.set()
        page.advance(1)
        await page.until(lambda: "early" in page.state.parts)
        since = page.state.parts["early"][0]
        page.advance(2)
        await page.until(lambda: page.shown()["answer"] == "best of 2")
        assert page.state.parts["early"][0] == since
        assert page.state.parts["answer"][0] > since

    play(story)


def test_it_rests_until_the_run_is_over(play, monkeypatch):
    monkeypatch.setattr(state_module, "REST", 1e9)
    monkeypatch.setattr(state_module, "QUICK", 0.0)

    async def story(page):
        page.sections.fitted.set()
        page.advance(1)
        await page.until(lambda: "answer" in page.shown())
        for trials in (2, 3):
            page.advance(trials)
        assert page.shown()["answer"] == "best of 1"
        page.advance(4, ended=True, verdict="kept")
        await page.until(lambda: page.state.complete)
        assert page.shown() == {"answer": "result of 4", "trials": "4 trials"}
        assert page.sections.calls == [("all", 1), ("result", 4)]

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
        def unreadable(best, *, ended):
            raise BoTunerError("no disk")

        page.sections.fitted.set()
        with monkeypatch.context() as patch:
            patch.setattr(page.sections, "made", unreadable)
            page.advance(1)
            await page.until(lambda: page.state.problem.endswith("no disk"))
        page.advance(2)
        await page.until(lambda: page.shown().get("answer") == "best of 2")
        await page.until(lambda: page.state.problem == "")

    play(story)


def test_an_unexpected_error_does_not_hold_up_the_result(play, monkeypatch):
    async def story(page):
        def broken(*_, **__):
            raise ValueError("a matrix is singular")

        with monkeypatch.context() as patch:
            patch.setattr(page.sections, "made", broken)
            page.advance(1)
            await page.until(
                lambda: page.state.problem.endswith("ValueError: a matrix is singular")
            )
        # Not before: the problem is over as soon as all parts are made.
        page.sections.fitted.set()
        page.advance(2)
        await page.until(lambda: page.shown().get("answer") == "best of 2")
        page.advance(2, ended=True, verdict="kept")
        await page.until(lambda: page.state.complete)
        assert page.shown()["answer"] == "result of 2"

    play(story)
