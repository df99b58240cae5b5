"""`tune --confirm` with a live page: the question stands there, and may be answered there."""

import json

import pytest
from axis import write_study
from commands import Fork, finish
from live_run import Page
from waiting import wait_until

from bo_tuner.plans import EventKind
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.web.live_page import LONGEST_QUESTION, _fitting

OPTIONS = ("--backend", "inprocess", "--safe", "--confirm", "--study", "axis.yaml")


@pytest.fixture
def asking(tmp_path, make_study):
    """A run without a terminal that asks before each trial."""
    write_study(tmp_path, make_study())
    file = tmp_path / "said.txt"
    with file.open("w") as said:
        process = Fork(*("tune", *OPTIONS, "--web", "--web-control"), folder=tmp_path, stderr=said)
    wait_until(lambda: "token=" in file.read_text(), "the address", process, file.read_text)
    yield Page(process, file)
    process.kill()
    process.communicate()


def asked(page, number):
    """The lines of a question, once it is asked."""
    lines = []

    def stands(state, _):
        question = state["now"].get("question", {})
        lines[:] = question.get("lines", ())
        return question.get("number") == number and lines

    page.state_when(stands)
    return lines


def test_it_is_answered_on_the_page(asking, tmp_path):
    assert asked(asking, 1)[0] == "next, trial 0:"
    # Of an earlier page, or without saying which one was read.
    assert asking.request("accept?question=7")[0] == 202
    assert asking.request("accept")[0] == 400
    assert asking.request("accept?question=one")[0] == 400
    assert asking.request("accept?question=1", Origin="http://evil.example")[0] == 403
    assert asking.request("accept?question=1", **{"X-Control-Token": "wrong"})[0] == 403
    assert asking.request("accept?question=1")[0] == 202
    second = asked(asking, 2)
    assert second[0] == "next, trial 1:"
    assert any(line.strip().startswith("nearest tried, trial 0: ") for line in second)
    assert asking.request("refuse?question=2")[0] == 202
    assert asked(asking, 3)[0] == "next, trial 1:"
    assert asking.request("end?question=3")[0] == 202
    assert asking.process.wait() == 0, asking.said.read_text()
    events = read_journal(tmp_path / "runs" / "latest" / "journal.sqlite").events
    kinds = [EventKind.ACCEPT, EventKind.REFUSE, EventKind.REFUSE, EventKind.FINISH]
    assert [event.kind for event in events] == kinds
    answers = [json.loads(event.detail) for event in events[:3]]
    assert {(a["on"], a["by"]) for a in answers} == {("live page", "127.0.0.1")}


def test_a_page_that_is_read_only_has_no_buttons(tmp_path, make_study):
    """Nobody could answer there, so that without a terminal there is nobody to ask."""
    write_study(tmp_path, make_study())
    code, _, err = finish(Fork("tune", *OPTIONS, "--web", folder=tmp_path))
    assert code == 2
    assert "--confirm: no terminal to ask on" in err


def test_a_long_question_says_what_is_left_out():
    lines = [f"  gain_{k}: 1 (trial before 2, default 3)" for k in range(200)]
    fitting = _fitting(lines)
    left = len(lines) - len(fitting) + 1
    assert fitting == [*lines[: len(lines) - left], f"and {left} lines more on the terminal"]
    assert sum(map(len, fitting)) <= LONGEST_QUESTION
    assert _fitting(lines[:3]) == lines[:3]
