"""`tune --confirm` with a live page: the question stands there, and may be answered there."""

import json
import re
import select
from dataclasses import replace

import pytest
from axis import write_study
from commands import Fork, finish
from live_run import Page
from waiting import wait_until

from bo_tuner.codec.writing import to_json
from bo_tuner.plans import EventKind
from bo_tuner.report.page import question_html
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.tuning.question import Asked, Change
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
    """A question as text, once it is asked."""
    found = []

    def stands(state, _):
        question = state["now"].get("question", {})
        found[:] = re.findall(r"[^<>]+(?=<)", question.get("html", ""))
        return question.get("number") == number and found

    page.state_when(stands)
    return " ".join("".join(found).split())


def test_it_is_answered_on_the_page(asking, tmp_path):
    first = asked(asking, 1)
    assert first.startswith("May trial 0 be tried?")
    assert "nothing is known yet to predict it by" in first
    # Of an earlier page, or without saying which one was read.
    assert asking.request("accept?question=7")[0] == 202
    assert asking.request("accept")[0] == 400
    assert asking.request("accept?question=one")[0] == 400
    assert asking.request("accept?question=1", Origin="http://evil.example")[0] == 403
    assert asking.request("accept?question=1", **{"X-Control-Token": "wrong"})[0] == 403
    assert asking.request("accept?question=1")[0] == 202
    second = asked(asking, 2)
    assert second.startswith("May trial 1 be tried?")
    assert "nearest tried, trial 0: " in second
    assert asking.request("refuse?question=2")[0] == 202
    assert asked(asking, 3).startswith("May trial 1 be tried?")
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
    changes = tuple(Change(f"gain_{k}", 1.0, 2.0, 3.0) for k in range(200))
    long = Asked(3, "start", "trial before", changes, remarks=("\U0001f600" * 900,))

    def parts(asked):
        return in_parts(json.dumps(to_json(asked)))

    ahead = ahead_of(parts(long))
    assert len(ahead) > 3
    assert all(len(json.dumps(message)) < select.PIPE_BUF for message in ahead)
    shown = LiveState(LiveSections(tmp_path))
    # Of an attempt that the pipe could not take to its end.
    for message in [*ahead[:2], *ahead]:
        shown.take(message)
    shown.take({"question": {"number": 7, "text": parts(long)[-1]}})
    assert shown.now["question"] == {"number": 7, "html": question_html(long)}
    # The next one begins anew, and in the end nothing is asked.
    short = replace(long, changes=changes[:1], remarks=())
    (text,) = parts(short)
    shown.take({"question": {"number": 8, "text": text}})
    assert shown.now["question"] == {"number": 8, "html": question_html(short)}
    shown.take({"question": {"number": 8, "text": ""}})
    assert shown.now["question"] == {"number": 8, "html": ""}
