"""The run's side of the page: a process that serves it, and gets each step by a pipe."""

import contextlib
import json
import os
import select
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from bo_tuner.codec.writing import to_json
from bo_tuner.evidence.words.verdict import headline
from bo_tuner.methods.stopping import StopAdvice
from bo_tuner.monitoring.control import RunControl
from bo_tuner.monitoring.progress import (
    advice_in_words,
    best_within,
    duration,
)
from bo_tuner.monitoring.status import RunStatus
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.storage.run_files import LOGS, open_file
from bo_tuner.study.study import Study
from bo_tuner.text import counted, printable
from bo_tuner.trials import Evaluation, Trial
from bo_tuner.tuning.observer import RunObserver
from bo_tuner.tuning.question import Given, Question, Reply
from bo_tuner.web.address import Address
from bo_tuner.web.request import Request

PERIOD = 0.2
"""Shortest time [s] between two messages on evaluations."""
LONGEST_TEXT = 600
"""Characters of a text in a message."""
LIVE_PAGE = "live page"
MOST_OF_QUESTION = 1500
"""Characters of a question in a message: of its JSON, in which a message escapes few once more."""
PATIENCE = 25.0
"""Longest time [s] that the page has at the end to show the result, if somebody reads it."""


class LivePage(RunObserver):
    """Starts the process that serves the page, and sends it the run; use it in a ``with`` block.

    The run never waits for that process: a message that the pipe cannot take is left out, since
    each one says all there is to say.
    """

    def __init__(
        self,
        study: Study,
        folder: Path,
        status: RunStatus,
        address: Address,
        warn: Callable[[str], None],
        control: RunControl | None = None,
        question: Question | None = None,
    ) -> None:
        self._study = study
        self._folder = folder
        self._status = status
        self._address = address
        self._warn = warn
        self._control = control
        self._question = question or Question()
        self._questions_sent = 0
        self._asked = ""
        self._ending = False
        # The thread that takes requests sends, too.
        self._lock = threading.RLock()
        self._pipe = -1
        self._process: subprocess.Popen[bytes] | None = None
        self._sent = 0.0
        self._running = 0
        self._ended = False

    def __enter__(self) -> Self:
        """Start the process."""
        socket = self._address.socket
        reads, self._pipe = os.pipe()
        os.set_blocking(self._pipe, False)
        requests, asks = (-1, -1) if self._control is None else os.pipe()
        # A signal of the terminal goes to the run alone, which then ends the page.
        self._log.parent.mkdir(exist_ok=True)
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT
        with os.fdopen(open_file(self._log, flags), "ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "bo_tuner.web", str(socket.fileno())],
                stdin=reads,
                stdout=log,
                stderr=log,
                pass_fds=[socket.fileno(), *([] if asks < 0 else [asks])],
                start_new_session=True,
                env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            )
        os.close(reads)
        socket.close()
        folder = str(self._folder.resolve())
        address = self._address
        settings: dict[str, object] = {
            "folder": folder,
            "token": address.token,
            "host": address.host,
        }
        if self._control is None:
            self._send(settings)
        else:
            os.close(asks)
            self._send(settings | {"control": asks})
            threading.Thread(
                target=self._take, args=[requests, self._control], name="live page", daemon=True
            ).start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Show the result to whoever reads the page, and end the process."""
        self._running = 0
        self._ended = True
        self._send_state()
        with self._lock:
            self._hang_up()
        if self._process is not None:
            try:
                self._process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def begin(self, phase: str, total: int) -> None:
        """Send a phase."""
        self._running = 0
        self._send_state()

    def recall(self, trials: Sequence[Trial], incumbent: Candidate | None) -> None:
        """Send the recorded trials."""
        self._send_state()

    def evaluation(self, evaluation: Evaluation) -> None:
        """Send an evaluation, unless the page got something just now."""
        self._forget_what_has_come()
        self._running += 1
        if time.monotonic() - self._sent >= PERIOD:
            self._send_state()

    def trial(self, trial: Trial, incumbent: Candidate | None) -> None:
        """Send a trial."""
        self._forget_what_has_come()
        self._running = 0
        self._send_state()

    def advance(self) -> None:
        """Send a step."""
        self._send_state()

    def advise(self, advice: StopAdvice) -> None:
        """Send the advice to stop."""
        self._send_state()

    def pause(self, paused: bool) -> None:
        """Send a pause."""
        self._forget_what_has_come()
        self._send_state()

    def waiting(self) -> None:
        """Send a question that has come up in the pause."""
        if self._questions_sent < self._question.number:
            self._send_state()

    @property
    def _log(self) -> Path:
        return self._folder / LOGS / "web.log"

    def _forget_what_has_come(self) -> None:
        """Take back what was asked, unless it is still to come."""
        to_come = self._control is not None and self._control.pause_requested
        if not self._ending and (self._status.now.paused or not to_come):
            self._asked = ""

    def _take(self, requests: int, control: RunControl) -> None:
        """Take the requests of the page until its process ends."""
        with os.fdopen(requests, encoding="ascii") as lines:
            for line in lines:
                word, *of_answer = line.split()
                if word in list(Reply):
                    number, who = of_answer
                    given = Given(Reply(word), LIVE_PAGE, who)
                    _, self._asked = control.answer(given, int(number))
                elif word == Request.ABORT:
                    self._ending = True
                    self._asked = control.abort(f"the {LIVE_PAGE}")
                elif word == Request.FINISH:
                    self._asked = control.finish()
                else:
                    self._asked = control.pause(word == Request.PAUSE)
                self._send_state()

    def _send_state(self) -> None:
        now, ended = self._status.now, self._ended
        best = now.incumbent
        asked, number = self._question.asked, self._question.number
        parts = in_parts("" if asked is None else json.dumps(to_json(asked)))
        texts = {
            "running": "" if ended else self._present(),
            "asked": "" if ended else self._asked,
            "advice": advice_in_words(now.advice, self._study) if now.advice else "",
        }
        self._sent = time.monotonic()
        messages: list[dict[str, object]] = [
            *ahead_of(parts),
            {
                "phase": now.phase,
                "done": now.done,
                "total": now.total,
                "trials": now.trials,
                "time_left": "" if ended or now.time_left is None else duration(now.time_left),
                "paused": now.paused,
                "pausing": self._control is not None and self._control.pause_requested,
                "ended": ended,
                "question": {"number": number, "text": parts[-1]},
                "best": printable(best_within(best, self._study)),
                "best_trial": best.trial.number if best and best.believed_feasible else None,
                "verdict": "" if now.verdict is None else printable(headline(now.verdict)),
                "texts": {
                    name: printable(text)[:LONGEST_TEXT] for name, text in texts.items() if text
                },
            },
        ]
        with self._lock:
            are_sent = [self._send(message) for message in messages]
        if all(are_sent):
            self._questions_sent = number

    def _present(self) -> str:
        """Return what runs at the moment."""
        now = self._status.now
        what = f"trial {now.trials}" if now.phase == "tuning" else now.phase
        if not self._running:
            return f"{what}, no test run finished yet"
        return f"{what}, {counted(self._running, 'test run')} finished"

    def _send(self, message: dict[str, object]) -> bool:
        """Send a message; returns whether the pipe could take it."""
        # The path of the run need not be UTF-8.
        text = json.dumps(message, ensure_ascii=False)
        line = text.encode("utf-8", "surrogatepass") + b"\n"
        # A pipe takes a short line whole or not at all (POSIX, write).
        if len(line) > select.PIPE_BUF:
            line = json.dumps(message | {"texts": {}}).encode() + b"\n"
        with self._lock, contextlib.suppress(BlockingIOError):
            if self._pipe < 0:
                return True
            try:
                os.write(self._pipe, line)
            except BrokenPipeError:
                self._hang_up()
                self._warn(f"the live page has ended, see {self._log}; the run continues")
            return True
        return False

    def _hang_up(self) -> None:
        if self._pipe >= 0:
            os.close(self._pipe)
            self._pipe = -1


def in_parts(text: str) -> list[str]:
    """Return the text of a question in parts that each fit into a message; at least one part."""
    return [
        text[begin : begin + MOST_OF_QUESTION]
        for begin in range(0, max(len(text), 1), MOST_OF_QUESTION)
    ]


def ahead_of(parts: Sequence[str]) -> list[dict[str, object]]:
    """Return the messages with the parts of a question ahead of its last one, and their places."""
    return [{"ahead": part, "place": place} for place, part in enumerate(parts[:-1])]
