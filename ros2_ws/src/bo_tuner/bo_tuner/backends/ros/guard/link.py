"""The tuner's connection to the guard of its nodes."""

import contextlib
import json
import os
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from rclpy.publisher import Publisher
from std_msgs.msg import String

from bo_tuner.backends.ros.decoding import UnreadableError, decode
from bo_tuner.backends.ros.errors import LostError
from bo_tuner.backends.ros.guard.messages import (
    BEAT_TOPIC,
    BEATS,
    END,
    IDLE,
    LATEST,
    PERIOD,
    RUN,
    STATE_TOPIC,
    Beat,
    State,
)
from bo_tuner.backends.ros.guard.plan import Plan, patience
from bo_tuner.backends.ros.tuner_node import POLL_PERIOD, TunerNode
from bo_tuner.errors import BackendError
from bo_tuner.storage.run_files import GUARD_RECORD
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import study_to_yaml

START = 60.0
"""Time [s] that a guard has to start."""
FRESH = 0.35
"""Age [s] of a state from which on a newer one is waited for: this process may have been stopped,
and a guard have acted meanwhile."""
DOUBT = 1.0
"""Time [s] that a process which was off the processor waits for a state before it has the machine
left safe: a guard that lives is heard ten times in it."""
LEASE = 1.5
"""Time [s] of silence after which ROS may take a process for dead: its lease is 2 s and more."""
DEAD, FORGOTTEN = 3.0, 25.0
"""Time [s] without a state after which a guard counts as dead, and the same for a process that was
stopped itself for longer than `LEASE`: the middleware has to discover all others anew."""
HEARD = 3.0
"""Time [s] to hear the state of a guard that is discovered."""
ANSWER = 10.0
"""Time [s] that one which somebody has started has to hear the first heartbeat."""
AWAKE = 0.25
"""Time [s] between two checks within which no guard has taken this process for stopped."""
LEAVE = 5.0
"""Time [s] that a guard has to end."""
LOG = "guard.log"


class GuardActedError(LostError):
    """The guard has stopped the machine and set the safe values.

    Attributes
    ----------
    takes_over
        Whether the tuner was not in control: somebody must see to the machine before it goes on.
    on_condition
        Whether the abort condition was the reason.
    ends
        Whether the guard watches no longer.
    """

    def __init__(self, text: str, *, takes_over: bool, on_condition: bool, ends: bool) -> None:
        super().__init__(text)
        self.takes_over = takes_over
        self.on_condition = on_condition
        self.ends = ends


class GuardSilentError(LostError):
    """Nothing is heard of the guard since this process was off the processor.

    It may have acted; it may have been off the processor, too, and then nobody has.
    """


class _Wire(Protocol):
    def send(self, beat: Beat) -> None:
        """Send a heartbeat; from any thread."""

    @property
    def problem(self) -> str:
        """Why the guard is known to have ended; empty if it is not."""

    def close(self) -> None:
        """Let go of the guard, which knows that no beat comes any more."""

    def kill(self) -> None:
        """Let go of a guard that does nothing any more, without waiting for it."""

    def leave(self) -> None:
        """Let go of a guard that goes on by itself."""


class _Process:
    """A guard that this process has started."""

    def __init__(self, settings: Mapping[str, Any], log: Path) -> None:
        log.parent.mkdir(parents=True, exist_ok=True)
        with log.open("ab") as output:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "bo_tuner.backends.ros.guard"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=output,
                # Signals of the terminal, and its end, are for the tuner.
                start_new_session=True,
                env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            )
        if self._process.stdin is None or self._process.stdout is None:
            raise BackendError("the guard has no pipes")
        self._problem = ""
        self._is_open = True
        self._lock = threading.Lock()
        self._pipe = self._process.stdin.fileno()
        self._write(json.dumps(settings))
        os.set_blocking(self._pipe, False)

    def send(self, beat: Beat) -> None:
        with self._lock:
            # A descriptor that is closed may be another file's soon.
            if self._is_open:
                self._write(str(beat))

    @property
    def problem(self) -> str:
        code = self._process.poll()
        if code is not None and not self._problem:
            said = b"" if self._process.stdout is None else self._process.stdout.read()
            self._problem = said.decode(errors="replace").strip() or f"it has ended with {code}"
        return self._problem

    def close(self) -> None:
        self._hang_up()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(LEAVE)
        self.kill()

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
        self._hang_up()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def leave(self) -> None:
        self._hang_up()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _hang_up(self) -> None:
        with self._lock:
            self._is_open = False
            if self._process.stdin is not None:
                self._process.stdin.close()

    def _write(self, text: str) -> None:
        # A pipe takes a short line whole (POSIX, write). One that is full is not read any more.
        with contextlib.suppress(BrokenPipeError, BlockingIOError):
            os.write(self._pipe, f"{text}\n".encode())


class _Topic:
    """A guard that somebody has started near the machine."""

    problem = ""

    def __init__(self, publisher: Publisher) -> None:
        self._publisher = publisher

    def send(self, beat: Beat) -> None:
        self._publisher.publish(String(data=str(beat)))

    def close(self) -> None:
        """Do nothing: the guard goes on, for the next tuner."""

    kill = leave = close


class GuardLink:
    """The connection to the guard of a study's nodes, which is joined or started.

    Attributes
    ----------
    unheeded : GuardActedError or None
        The last act that `look` raised, until it is handled: a wait for a node may have caught it
        as one of many reasons why the node is not there.
    is_silent : bool
        Whether `look` has raised that the guard is silent, and it still is.
    """

    def __init__(
        self, tuner: TunerNode, plan: Plan, folder: Path, *, attached: bool = True
    ) -> None:
        self._tuner = tuner
        self._attached = attached
        self._plan = plan
        self._folder = folder
        self._name = ""
        self._wire: _Wire | None = None
        self._states: dict[str, State] = {}
        self._heard: dict[str, float] = {}
        self._phase, self._run, self._acts = IDLE, 0, 0
        self.unheeded: GuardActedError | None = None
        self.is_silent = False
        self._is_begun = False
        self._ended = ""
        self._checked = self._waited = self._stopped = 0.0
        self._over = threading.Event()
        self._thread: threading.Thread | None = None
        # rclpy passes on what it knows of a message to whoever takes two arguments.
        hear: Any = self._hear
        self._subscription = tuner.node.create_subscription(
            String, STATE_TOPIC, hear, LATEST, raw=True
        )
        self._publisher = tuner.node.create_publisher(String, BEAT_TOPIC, BEATS)

    def begin(
        self,
        study: Study,
        ros_arguments: Sequence[str],
        values: Mapping[str, Mapping[str, object]] | None = None,
    ) -> None:
        """Take the guard that is there, or start one, and let it watch from now on."""
        self._thread = threading.Thread(target=self._go_on, name="heartbeat", daemon=True)
        self._thread.start()
        if values is not None or not self._find():
            try:
                self._start(study, ros_arguments, values)
                self._is_begun = True
                return
            except BackendError:
                # One that is there may be discovered late; it is why another one does not start.
                if values is not None or not self._find():
                    raise
        if not self._tuner.wait_until(self._is_watched, ANSWER):
            raise BackendError(
                f"the guard of the nodes does not hear this tuner within {ANSWER:g} s: it waits "
                "for a node, or the network carries nothing to it"
            )
        self._is_begun = True

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics that the guard would publish, and is known as a publisher of."""
        state = self._states.get(self._name)
        return () if state is None else state.topics

    @contextlib.contextmanager
    def run(self) -> Iterator[None]:
        """Let the abort condition count within, and the tuner count as hung if it is not served."""
        self._run += 1
        self._turn(RUN)
        try:
            yield
        finally:
            self._turn(IDLE)

    def look(self, *, at_rest: bool) -> None:
        """See whether the guard is there and has not acted."""
        if self._ended:
            raise BackendError(self._ended)
        if self._wire is None or not self._is_begun:
            return
        self._take()
        now = time.monotonic()
        gap, self._checked = now - self._checked, now
        # Then nothing was missed: the machine is watched, or safe, while the guard is waited for.
        is_awake = gap < AWAKE or self.is_silent
        doubted = now + DOUBT
        if not is_awake:
            # A process that was stopped, and is slow now, waits no shorter.
            self._waited = max(self._waited, now + DEAD)
        # The clock is that of the stamps at which messages came in.
        while time.time() - self._heard.get(self._name, 0.0) > FRESH:
            if gap > LEASE and not self.is_silent:
                self._waited, self._stopped = now + FORGOTTEN, gap
            problem = self._wire.problem
            if problem or now > self._waited:
                wire, self._wire = self._wire, None
                # The machine does not wait until it ends by itself.
                wire.kill()
                self._ended = self._why_ended(problem)
                raise BackendError(self._ended)
            if is_awake:
                return
            if not at_rest and now > doubted:
                self.is_silent = True
                raise GuardSilentError(
                    "the guard of the nodes is silent since this process was off the processor"
                )
            time.sleep(POLL_PERIOD)
            now = time.monotonic()
            gap, self._checked = now - self._checked, now
            self._take()
        self.is_silent = False
        self._waited, self._stopped = time.monotonic() + DEAD, 0.0
        state = self._states[self._name]
        # While it acts, nobody is to be in its way.
        while state.acts > self._acts and not state.outcome and time.monotonic() < self._waited:
            time.sleep(POLL_PERIOD)
            self._take()
            state = self._states[self._name]
        if state.acts > self._acts:
            self._acts = state.acts
            self._phase = IDLE
            self._beat()
            self.unheeded = GuardActedError(
                f"the guard has stopped the machine: {state.reason}; "
                f"{state.outcome or 'it is still at it'}",
                takes_over=state.takes_over,
                on_condition=state.on_condition,
                ends=state.ends,
            )
            raise self.unheeded

    def _why_ended(self, problem: str) -> str:
        """Return why the guard is no longer there, in a line; the `problem` is its own."""
        if self._stopped and not problem:
            return (
                f"this process was stopped for {self._stopped:.0f} s, and its guard is not heard "
                "since then; look at the machine, then resume the run"
            )
        return (
            f"the guard of the nodes has ended: {problem or 'nothing is heard of it'}; see "
            f"{self._folder / LOG}"
        )

    def end(self) -> None:
        """Report to the guard that the nodes are left as they are to be, and let go of it."""
        if (wire := self._still()) is not None:
            self._turn(END)
            wire.close()
            self._wire = None

    def hand_over(self) -> None:
        """Let go of the guard while the nodes are not: to it this process has died."""
        if (wire := self._still()) is not None:
            wire.leave()
            self._wire = None

    def _still(self) -> _Wire | None:
        """Send no more heartbeats; returns the connection, if there is one still."""
        self._over.set()
        if self._thread is not None:
            self._thread.join()
        return self._wire

    def _find(self) -> bool:
        """Take the guard of these nodes that somebody has started, if there is one."""
        publishers = self._tuner.node.count_publishers

        def heard() -> bool:
            self._take()
            return len(self._states) >= publishers(STATE_TOPIC)

        self._tuner.wait_until(heard, HEARD)
        nodes = set(self._plan.full_names(self._tuner.node.get_namespace()))
        for state in self._states.values():
            shared = sorted(nodes & set(state.nodes))
            # That of a tuner which has just ended will end, too.
            if not shared or not (state.stands and state.settled):
                continue
            if state.digest != self._plan.digest:
                raise BackendError(
                    f"the guard of {shared[0]} is one of study {state.study}, with other safe "
                    "values, stop messages or conditions; start it with this study"
                )
            self._name, self._acts = state.guard, state.acts
            self._wire = _Topic(self._publisher)
        return self._wire is not None

    def _start(
        self,
        study: Study,
        ros_arguments: Sequence[str],
        values: Mapping[str, Mapping[str, object]] | None,
    ) -> None:
        self._name = uuid.uuid4().hex
        settings = {
            "name": self._name,
            "study": study_to_yaml(study),
            "values": values,
            "patience": patience(study),
            "attached": self._attached,
            "ros_arguments": list(ros_arguments),
            "record": str((self._folder / GUARD_RECORD).resolve()),
        }
        self._wire = wire = _Process(settings, self._folder / LOG)
        begun = False
        try:
            self._tuner.wait_until(lambda: self._is_watched() or bool(wire.problem), START)
            begun = self._is_watched() and not wire.problem
            if not begun:
                problem = wire.problem or f"it does not answer within {START:g} s"
                raise BackendError(f"the guard of the nodes cannot start: {problem}")
        finally:
            if not begun:
                self._wire = None
                wire.kill()

    def _is_watched(self) -> bool:
        """Whether the guard hears this tuner: from now on it acts if that ends."""
        self._take()
        state = self._states.get(self._name)
        return state is not None and state.watches

    def _turn(self, phase: str) -> None:
        self._phase = phase
        self._beat()

    def _beat(self) -> None:
        wire = self._wire
        if wire is not None:
            wire.send(Beat(self._name, self._phase, self._run, self._acts))

    def _go_on(self) -> None:
        while not self._over.wait(PERIOD):
            # In a run this process counts as alive only while it watches the machine.
            if self._phase != RUN or time.monotonic() - self._tuner.served < FRESH:
                self._beat()

    def _hear(self, data: bytes, info: Any) -> None:
        """Take a state: called by the executor, and by `_take`."""
        with contextlib.suppress(UnreadableError):
            state = State.read(decode(data, String).data)
            if state is not None:
                self._states[state.guard] = state
                self._heard[state.guard] = info["received_timestamp"] * 1e-9

    def _take(self) -> None:
        """Take the states that came in and wait."""
        handle = self._subscription.handle
        with handle:
            while taken := handle.take_message(String, True):
                self._hear(*taken)
