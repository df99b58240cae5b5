"""A process that runs code of others, and is asked."""

import os
import signal

import pytest

from bo_tuner.asked_process import AskedProcess, NoAnswerError

HEAD = """\
import os, signal, sys, time
from multiprocessing.connection import Connection
from bo_tuner.asked_process import serve
connection = Connection(int(sys.argv[1]))
"""
LARGE = b"x" * 10_000_000
"""More than a connection takes that nobody reads."""


class Stop(BaseException):
    """In place of a signal."""


@pytest.fixture
def asked(tmp_path):
    """Make a process of a program."""
    made = []

    def make(program, interrupted=lambda: None):
        (tmp_path / "asked_program.py").write_text(HEAD + program, encoding="utf-8")
        made.append(AskedProcess("asked_program", str(tmp_path), interrupted))
        return made[-1]

    yield make
    for process in made:
        process.close()


def test_each_question_has_its_own_answer_where_a_forked_child_comes_back_too(asked):
    process = asked(
        """
def answer(question):
    first = os.getpid()
    if child := os.fork():
        os.waitpid(child, os.WNOHANG)
    return question, os.getpid() == first

serve(connection, answer)
"""
    )
    assert [process.ask(number, 60.0) for number in range(10)] == [(n, True) for n in range(10)]


def test_an_answer_to_an_earlier_question_is_passed_over(asked):
    process = asked(
        """
earlier = None
while True:
    number, question = connection.recv()
    if earlier is not None:
        connection.send(earlier)
    earlier = number, question
    connection.send(earlier)
"""
    )
    assert [process.ask(text, 60.0) for text in "abcd"] == list("abcd")


@pytest.mark.parametrize(
    "program",
    [
        "time.sleep(1000.0)",
        "connection.recv(); os.write(connection.fileno(), b'half'); time.sleep(1000.0)",
        "os.kill(os.getpid(), signal.SIGSTOP)",
    ],
    ids=["reads nothing", "half an answer", "stands still"],
)
def test_a_process_that_says_nothing_is_waited_for_as_long_as_was_said(asked, program):
    with pytest.raises(NoAnswerError, match=r"took longer than its timeout of 0\.1 s"):
        asked(program).ask(LARGE, 0.1)

    def interrupted():
        raise Stop

    process = asked(program, interrupted)
    with pytest.raises(Stop):
        process.ask(LARGE)
    assert process.pid is None


def test_one_that_has_left_a_child_with_its_connection(asked, tmp_path):
    process = asked(
        """
if os.fork() == 0:
    os.setsid()
    with open("child", "w") as file:
        file.write(str(os.getpid()))
    time.sleep(1000.0)
while not os.path.exists("child") or not os.path.getsize("child"):
    time.sleep(0.01)
sys.exit(3)
"""
    )
    with pytest.raises(NoAnswerError, match=r"^ended its process: exit code 3$"):
        process.ask("whatever", 60.0)
    os.kill(int((tmp_path / "child").read_text()), signal.SIGKILL)


@pytest.mark.parametrize(
    ("end", "said"),
    [
        ("time.sleep(0.5); sys.exit(2)", "exit code 2"),
        ("os.kill(os.getpid(), signal.SIGABRT)", "killed by SIGABRT"),
        ("os.kill(os.getpid(), 40)", "killed by signal 40"),
    ],
)
def test_how_it_has_ended(asked, end, said):
    """Also where it takes its time, once it has closed the connection."""
    with pytest.raises(NoAnswerError, match=f"^ended its process: {said}$"):
        asked(f"connection.recv(); connection.close(); {end}").ask("whatever", 60.0)
