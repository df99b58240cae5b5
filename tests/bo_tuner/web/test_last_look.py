import asyncio
from types import SimpleNamespace

import pytest
from waiting import DEADLINE

from bo_tuner.web import server


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    monkeypatch.setattr(server, "LAST_LOOK", 10.0 * DEADLINE)
    monkeypatch.setattr(server, "LEFT", 0.05)


def state_with(*readers):
    return SimpleNamespace(watched=True, shown=False, readers=set(readers))


def last_look(state, meanwhile=None):
    """What was seen of the state by the end of the last look."""

    async def look():
        async with asyncio.timeout(DEADLINE):
            looking = asyncio.create_task(server._last_look(state))
            if meanwhile is not None:
                await asyncio.sleep(10.0 * server.LEFT)
                assert not looking.done()
                meanwhile()
            await looking

    asyncio.run(look())


def test_nobody_is_waited_for_who_has_left():
    last_look(state_with())


def test_a_reader_that_waits_is_shown_the_end():
    state = state_with("reader")
    last_look(state, lambda: setattr(state, "shown", True))


def test_a_reader_that_leaves_ends_it():
    state = state_with("reader")
    last_look(state, state.readers.clear)
