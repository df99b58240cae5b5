"""Each process that a command starts beside itself is killed at three moments of its life.

The commands work on a short study of the motor and the controller of ``examples/unchanged_system``,
which they start, under a guard, with a metric that a Python function computes in a process of its
own; with several workers, on an object in their processes. Killed is a process as soon as it is
there, midway, and shortly before it would end, as it did in a run that nobody disturbed.

Whatever comes of it, a command must end, and tell the same by its exit code, to ``--notify`` and as
JSON; name a way to go on where it has begun something that can be resumed; show no traceback; and
leave no process behind. Before its first run it may end with an error and exit code 2.
"""

import contextlib
import json
import os
import queue
import random
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import psutil
from busy_computer import busy
from common import BENCHMARKS, provenance, result_parser, table, write_result

from bo_tuner.backends.ros.isolation import isolated_environment
from bo_tuner.study import strict_yaml

EXAMPLE = BENCHMARKS.parent / "examples" / "unchanged_system"
SEED = 1
LOADS = (0, 8)
"""Numbers of busy programs beside them."""
MOMENTS: Mapping[str, float] = {"at once": 0.0, "midway": 0.5, "late": 0.9}
"""Moments, as parts of the life of a process."""
LONGEST = 240.0
"""Time [s] within which a command must end."""
NODE, GUARD, FUNCTION, WORKER = "node", "guard", "function", "worker"
SETTINGS = {
    "OPENBLAS_NUM_THREADS": "1",
    # Commands at once, and other programs, make heartbeats late.
    "BO_TUNER_GUARD_TIMEOUT": "5",
}
MARKS = {
    NODE: "pid_node.py",
    GUARD: "bo_tuner.backends.ros.guard",
    FUNCTION: "bo_tuner.metrics.python_worker",
    WORKER: "multiprocessing.spawn",
}
"""What the command line of each kind of process has in it."""
BY_NODES = (NODE, GUARD, FUNCTION)
NOTIFY = ("--notify", 'echo "$BO_TUNER_EXIT_CODE" >told')
NEW = ("tune", "--json-lines", *NOTIFY)
AXIS = """\
import time
from pathlib import Path


class Axis:
    def set_parameters(self, values):
        self.__dict__.update(values)

    def evaluate(self):
        Path("ran").touch()
        time.sleep(0.2)
        return {"status": "ok", "error": self.load * (1 + (self.gain - 0.3) ** 2)}
"""
OF_AXIS = """\
name: axis
nodes: {axis: {node: axis, result: ~/result, object: "axis:Axis"}}
parameters: {gain: {node: axis, type: double, bounds: [0.0, 1.0], default: 0.5}}
contexts: {load: {node: axis, distribution: uniform, bounds: [1.0, 2.0]}}
trigger: {node: axis, service: ~/cut}
metrics: {error: {node: axis}}
objective: {metric: error}
budget: {trials: 5, initial_trials: 3, drawn_contexts: 4, validation_draws: 10}
"""
JUDGE = """\
from pathlib import Path

import numpy as np


def largest(signals):
    Path("ran").touch()
    _, values = signals["angle"]
    return float(np.max(np.abs(values)))
"""


@dataclass(frozen=True)
class Command:
    """A command, the processes that it has, and whether there is something to resume."""

    name: str
    arguments: Sequence[str]
    helpers: Sequence[str]
    hint: str = ""


COMMANDS = (
    Command("tune", (*NEW, "--study", "study.yaml"), BY_NODES, "resume it with: tune"),
    Command(
        "tune --workers",
        (*NEW, "--study", "axis.yaml", "--backend", "inprocess", "--workers", "2"),
        (WORKER,),
        "resume it with: tune",
    ),
    Command(
        "validate",
        ("validate", "runs/latest", "--runs", "40", *NOTIFY),
        BY_NODES,
        "continue with: validate",
    ),
    Command(
        "validate --against",
        ("validate", "--against", "runs/latest/certificates/0001.json", "--runs", "5", *NOTIFY),
        BY_NODES,
    ),
    Command("check", ("check", "study.yaml"), BY_NODES),
    Command("try", ("try", "study.yaml"), BY_NODES),
    Command("replay", ("replay", "runs/latest"), BY_NODES),
)


def write_studies(folder: Path) -> None:
    """Write what the commands work on."""
    content: Any = strict_yaml.parse((EXAMPLE / "study.yaml").read_text()).value
    for name in ("pid", "motor"):
        program = EXAMPLE / f"{name}_node.py"
        content["nodes"][name] = {"node": name, "command": f"{sys.executable} {program}"}
    content["guard"] = True
    content["park"] = {"parameters": {"kp": 0.25}}
    content["run"]["end"] = {"after": 0.5}
    content["metrics"]["largest"] = {"python": "judge:largest", "unit": "rad"}
    content["budget"] = {
        "trials": 3, "initial_trials": 3, "drawn_contexts": 1, "validation_draws": 3
    }  # fmt: skip
    content["certificate"] = {"draws": 40, "confidence": 0.5}
    (folder / "study.yaml").write_text(strict_yaml.dump(content))
    (folder / "judge.py").write_text(JUDGE)
    (folder / "axis.yaml").write_text(OF_AXIS)
    (folder / "axis.py").write_text(AXIS)


class Life:
    """A command at work in a folder, and the processes below it."""

    def __init__(self, command: Command, folder: Path, domain: int) -> None:
        self._folder = folder
        for name in ("told", "ran"):
            (folder / name).unlink(missing_ok=True)
        with (folder / "out").open("w") as out, (folder / "err").open("w") as err:
            self.process = psutil.Popen(
                [sys.executable, "-m", "bo_tuner", *command.arguments],
                cwd=folder,
                env=os.environ | isolated_environment(domain) | SETTINGS,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
            )
        self.seen: dict[int, psutil.Process] = {}

    def helpers(self, kind: str) -> list[psutil.Process]:
        """Return the processes of a kind that are there."""
        found = []
        with contextlib.suppress(psutil.NoSuchProcess):
            for child in self.process.children(recursive=True):
                self.seen[child.pid] = child
                with contextlib.suppress(psutil.NoSuchProcess, psutil.ZombieProcess):
                    line = " ".join(child.cmdline())
                    if MARKS[kind] in line and "resource_tracker" not in line:
                        found.append(child)
        return found

    def ended(self) -> bool:
        """Whether the command has ended."""
        return self.process.poll() is not None

    def text(self, name: str) -> str:
        """Return what it has said."""
        path = self._folder / name
        return path.read_text(errors="replace") if path.exists() else ""


def spans(command: Command, folder: Path, domain: int) -> dict[str, float]:
    """Let a command come to its end; returns how long [s] its processes live."""
    life = Life(command, folder, domain)
    first: dict[str, float] = {}
    last: dict[str, float] = {}
    while not life.ended():
        for kind in command.helpers:
            if life.helpers(kind):
                first.setdefault(kind, time.monotonic())
                last[kind] = time.monotonic()
        time.sleep(0.02)
    if life.process.returncode not in (0, 3):
        raise SystemExit(f"error: {command.name} ends undisturbed with: {life.text('err')}")
    if missing := set(command.helpers) - set(first):
        raise SystemExit(f"error: {command.name} has no {', '.join(missing)}")
    return {kind: last[kind] - first[kind] for kind in first}


def killed(
    command: Command, kind: str, after: float, folder: Path, domain: int
) -> dict[str, Any] | None:
    """Kill a process of a command so long [s] after it has come; None if it had ended by then."""
    life = Life(command, folder, domain)
    while not (there := life.helpers(kind)):
        if life.ended():
            return None
        time.sleep(0.005)
    time.sleep(after)
    there = life.helpers(kind) or there
    if life.ended() or not there[0].is_running():
        life.process.wait()
        return None
    has_begun = (folder / "ran").exists()
    there[0].kill()
    begun = time.monotonic()
    while not life.ended() and time.monotonic() - begun < LONGEST:
        life.helpers(kind)
        time.sleep(0.02)
    seconds = time.monotonic() - begun
    has_ended = life.ended()
    if not has_ended:
        life.process.kill()
    code = life.process.wait()
    _, left = psutil.wait_procs(list(life.seen.values()), timeout=10.0)
    for process in left:
        with contextlib.suppress(psutil.NoSuchProcess):
            process.kill()
    return {
        "ended": has_ended,
        "exit code": code,
        "seconds": seconds,
        "said": (life.text("err").strip().splitlines() or [""])[-1].replace(str(folder), "."),
        "wrong": wrong(command, code, life, begun=has_begun, has_ended=has_ended, left=len(left)),
    }


def wrong(
    command: Command, code: int, life: Life, *, begun: bool, has_ended: bool, left: int
) -> list[str]:
    """Return what of the end is not as it should be."""
    said = life.text("err")
    if (
        code == 2
        and not begun
        and said.count("\nerror: ") + said.startswith("error: ") == 1
        and not left
    ):
        # Nothing has begun: there is nothing to tell of, or to go on with.
        return ["told of nothing"] if life.text("told") else []
    found = [] if has_ended else [f"no end within {LONGEST:g} s"]
    if code not in (0, 1, 3):
        found.append(f"exit code {code}")
    if "Traceback" in said:
        found.append("a traceback")
    if NOTIFY[0] in command.arguments and life.text("told").strip() != str(code):
        found.append(f"told {life.text('told').strip() or 'nobody'}")
    if "--json-lines" in command.arguments:
        last = json.loads((life.text("out").splitlines() or ["{}"])[-1])
        if (last.get("event"), last.get("exit_code")) != ("end", code):
            found.append("no end as JSON")
    if code == 1 and command.hint not in said:
        found.append("no way to go on")
    if left:
        found.append(f"{left} processes left")
    return found


def made(folder: Path, domain: int) -> Path:
    """Make a run and its certificate, which commands are about; returns their folder."""
    folder.mkdir()
    write_studies(folder)
    for command in (COMMANDS[0], COMMANDS[2]):
        life = Life(command, folder, domain)
        if life.process.wait() not in (0, 3):
            raise SystemExit(f"error: {command.name}: {life.text('err')}")
    return folder


def cases(folder: Path, jobs: int, first: int, minutes: float) -> list[dict[str, Any]]:
    """Kill each process of each command at each moment, in any order, until the time is over."""
    domains: queue.SimpleQueue[int] = queue.SimpleQueue()
    for domain in range(first, first + jobs):
        domains.put(domain)
    original = made(folder / "made", first)

    def anew(act: Callable[..., Any], *arguments: Any) -> Any:
        """Do something in a copy of the folder and a ROS domain of its own."""
        domain = domains.get()
        copy = Path(tempfile.mkdtemp(dir=folder))
        try:
            shutil.copytree(original, copy, symlinks=True, dirs_exist_ok=True)
            return act(*arguments, copy, domain)
        finally:
            domains.put(domain)

    with ThreadPoolExecutor(jobs) as pool:
        lives = list(pool.map(partial(anew, spans), COMMANDS))
        begun = time.monotonic()

        def one(case: tuple[int, str, str]) -> dict[str, Any] | None:
            if time.monotonic() - begun > 60.0 * minutes:
                return None
            number, kind, moment = case
            command, after = COMMANDS[number], MOMENTS[moment] * lives[number][kind]
            about = {"command": command.name, "killed": kind, "moment": moment}
            end = anew(killed, command, kind, after)
            found = about | {"hit": end is not None} | (end or {})
            print(found, flush=True)
            return found

        every = [
            (number, kind, moment)
            for number, command in enumerate(COMMANDS)
            for kind in command.helpers
            for moment in MOMENTS
        ]
        random.Random(SEED).shuffle(every)
        return [found for found in pool.map(one, every) if found is not None]


def summed_up(found: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return by what was killed how the commands ended."""
    result = {}
    for kind in MARKS:
        of_kind = [case for case in found if case["killed"] == kind and case["hit"]]
        if of_kind:
            seconds = [case["seconds"] for case in of_kind]
            result[kind] = {
                "cases": len(of_kind),
                "with a result": sum(case["exit code"] in (0, 3) for case in of_kind),
                "at the start": sum(case["exit code"] == 2 for case in of_kind),
                "wrong": sum(bool(case["wrong"]) for case in of_kind),
                "median": statistics.median(seconds),
                "worst": max(seconds),
            }
    return result


def main() -> None:
    """Kill and report; exit code 1 if an end is not as it should be."""
    parser = result_parser(__doc__ or "", "helper_kills.json")
    parser.add_argument("--jobs", type=int, default=1, help="commands at once")
    parser.add_argument("--minutes", type=float, default=60.0, help="the longest time of each load")
    parser.add_argument("--loads", type=int, nargs="+", default=LOADS, help="busy programs beside")
    parser.add_argument("--domain", type=int, default=92, help="ROS domain of the first of them")
    arguments = parser.parse_args()
    result: dict[str, Any] = {"provenance": provenance(), "jobs": arguments.jobs}
    rows = []
    for load in arguments.loads:
        with tempfile.TemporaryDirectory() as name, busy(load):
            os.environ["XDG_STATE_HOME"] = name
            found = cases(Path(name), arguments.jobs, arguments.domain, arguments.minutes)
        result[f"beside {load}"] = {
            "cases": found,
            "by process": summed_up(found),
            "load_average": os.getloadavg(),
        }
        rows += [[load, kind, *row.values()] for kind, row in summed_up(found).items()]
        write_result(arguments.result, result)
    header = [
        "busy programs",
        "killed",
        "times",
        "with a result",
        "at the start",
        "wrong",
        "median [s]",
        "worst",
    ]
    print(table(header, rows))
    if any(row[5] for row in rows):
        sys.exit(1)


if __name__ == "__main__":
    main()
