"""`tune --confirm` with a live page: the question stands there, and may be answered there."""

import json
import select

import pytest
from axis import write_study
from commands import Fork, finish
from live_run import Page
from waiting import wait_until

from bo_tuner.plans import EventKind
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.web.live_page import ahead_of, in_parts
from bo_tuner.web.sections import LiveSections
from bo_tuner.web.state import LiveState

OPTIONS = ("--backend", "inprocess", "--confirm", "--study", "axis.yaml")


@pytest.fixture
def asking(tmp_path, make_study):
    """A run without a terminal that asks before each trial."""
    write_study(tmp_path, make_study(safe_search=True))
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
    write_study(tmp_path, make_study(safe_search=True))
    code, _, err = finish(Fork("tune", *OPTIONS, "--web", folder=tmp_path))
    assert code == 2
    assert "--confirm: no terminal to ask on" in err


def test_a_long_question_stands_there_whole(tmp_path):
    """In several messages, each of a length that the pipe takes as a whole."""
    lines = ["", *(f"  gain_{k}: 1 (trial before 2, default 3)" for k in range(200))]
    lines.append("\U0001f600" * 900)
    parts = in_parts(lines)
    ahead = ahead_of(parts)
    assert len(ahead) > 3
    assert all(len(json.dumps(message)) < select.PIPE_BUF for message in ahead)
    shown = LiveState(LiveSections(tmp_path))
    # Of an attempt that the pipe could not take to its end.
    for message in [*ahead[:2], *ahead]:
        shown.take(message)
    shown.take({"question": {"number": 7, "lines": parts[-1]}})
    stands = shown.now["question"]
    assert (stands["number"], "".join(stands["lines"])) == (7, "".join(lines))
    assert stands["lines"][:201] == lines[:201]
    # The next one begins anew.
    shown.take({"question": {"number": 8, "lines": ["next"]}})
    assert shown.now["question"] == {"number": 8, "lines": ["next"]}
