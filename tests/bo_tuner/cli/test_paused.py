"""A key on the terminal lets a paused run go on."""

import os
import pty
import sys

import pytest
from waiting import wait_until

from bo_tuner.cli import paused


@pytest.fixture
def keyboard(monkeypatch):
    """What types on the terminal of this process, which is in its foreground."""
    ours, theirs = pty.openpty()
    with os.fdopen(theirs) as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        monkeypatch.setattr("bo_tuner.cli.paused.os.tcgetpgrp", lambda _: os.getpgrp())
        yield lambda text: os.write(ours, text.encode())
    os.close(ours)


@pytest.fixture
def went_on():
    return []


@pytest.fixture
def by_key(went_on):
    return paused.ContinueByKey(lambda: went_on.append(True))


@pytest.mark.parametrize("typed", ["c\n", "C\n", "what?\nc\n"])
def test_the_key_lets_it_go_on(keyboard, by_key, went_on, typed):
    by_key.pause(True)
    keyboard(typed)
    wait_until(lambda: by_key.waiting() or went_on, "the run to go on")


def test_what_was_typed_before_the_pause_is_not_meant_for_it(keyboard, by_key, went_on):
    keyboard("c\n")
    by_key.pause(True)
    keyboard("no\n")
    for _ in range(10):
        by_key.waiting()
    assert not went_on


def test_a_question_has_the_terminal_to_itself(keyboard, by_key, went_on):
    by_key.asking(True)
    keyboard("c\n")
    by_key.waiting()
    assert not went_on
    assert sys.stdin.readline() == "c\n"


def test_in_the_background_nothing_is_read(keyboard, by_key, went_on, monkeypatch):
    """A process there that reads from its terminal is stopped."""
    monkeypatch.setattr("bo_tuner.cli.paused.os.tcgetpgrp", lambda _: os.getpgrp() + 1)
    assert not paused.has_terminal()
    by_key.pause(True)
    keyboard("c\n")
    by_key.waiting()
    assert not went_on


def test_without_a_terminal_there_is_no_such_way(monkeypatch, by_key, tmp_path):
    (tmp_path / "input").write_text("c\n")
    with (tmp_path / "input").open() as lines:
        monkeypatch.setattr(sys, "stdin", lines)
        assert not paused.has_terminal()
        by_key.pause(True)
        by_key.waiting()
        assert lines.read() == "c\n"
