"""A tuner as a process of its own, at work on the servo: ``guarded_tuner.py FOLDER KIND [GUARD]``.

It says each step in a line, and performs evaluations, as many as it is told to on standard input.
Each kind has another fault: ``plain`` has none, ``blind`` overlooks the abort condition, ``slow``
judges it late, ``hung`` does not look any more once the first run is in progress, ``waiting`` takes
2 s until it has its nodes back after a lost evaluation, and ``fit`` computes between two runs.
"""

import json
import sys
import time
from pathlib import Path

from servo import SAFE, UNSTABLE, run, study

from bo_tuner.backends.ros import run_watch
from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.errors import BackendError

STOP = -0.5
GUARDED = {
    "run": {
        "before": [],
        "after": [{"publish": {"topic": "setpoint", "message": {"data": STOP}}}],
        "end": {"when": "t > 50"},
        "timeout": 60.0,
        "abort_when": "abs(angle) > 3",
    },
    "park": {"parameters": {"gain": SAFE}},
}
"""Changes of the servo's study: runs that go on until somebody ends them."""


def say(**facts):
    print(json.dumps(facts), flush=True)


def hang_in_run(backend):
    """Do not look any more, 0.2 s after the start of a run, for 2 s."""
    hung = []

    def hang():
        procedure = backend._procedure
        if procedure is None or not procedure._is_recording or hung:
            return
        if procedure._recorder.seconds > 0.2:
            hung.append(True)
            time.sleep(2.0)

    look = backend._look
    backend._look = lambda: (hang(), look())


def judge_late(watch, record):
    """Judge the abort condition only once the guard has acted on it, as on a busy computer."""
    holds = watch._holds

    def late(self, condition, *times):
        found = holds(self, condition, *times)
        while condition is self._abort and found is not None and not record.exists():
            self._tuner.served = time.monotonic()
            time.sleep(0.01)
        return found

    watch._holds = late


def wait_for_nodes(backend):
    """Take 2 s, in which the tuner looks around as always, to have nodes back."""
    get_back = backend._opened.bringup.get_back

    def slowly():
        say(waiting=True)
        backend._tuner.spin_for(2.0)
        get_back()

    backend._opened.bringup.get_back = slowly


def main(folder, kind, **changes):
    merged = {**GUARDED, **changes}
    if kind == "short":
        merged["run"] = {**merged["run"], "end": {"when": "t > 0.2"}}
    if kind == "blind":
        run_watch.RunWatch._holds = lambda *_: None
        run_watch.RunWatch._holds_late = lambda *_: False
    if kind == "slow":
        judge_late(run_watch.RunWatch, Path(folder, "guard.jsonl"))
    backend = RosBackend(
        study(**merged), Path(folder), attach=True, guard=True, halt=lambda text: say(halt=text)
    )
    if kind == "hung":
        hang_in_run(backend)
    try:
        backend.open()
        if kind == "waiting":
            wait_for_nodes(backend)
        say(open=True)
        for line in sys.stdin:
            if line.strip() == "fit":
                end = time.monotonic() + 1.5
                while time.monotonic() < end:
                    sum(range(1000))
                say(fitted=True)
                continue
            outcome = run(backend, UNSTABLE if kind in ("blind", "slow") else 0.75)
            say(state=str(outcome.state), reason=outcome.reason)
    except BackendError as error:
        say(error=str(error))
    finally:
        try:
            backend.close()
        except BackendError as error:
            say(left=str(error))
        say(closed=True)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], **json.loads((sys.argv[3:] or ["{}"])[0]))
