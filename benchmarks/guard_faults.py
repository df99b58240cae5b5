"""Faults of a tuner at work on attached nodes: how long until its guard has the machine safe.

Full runs are those of ``tune --attach`` on ``examples/unchanged_system``: in the midst of a run the
tuner is killed, stopped, made to hang, or made blind to the condition that ends a run. From the
fault on (for a blind tuner: from the message that fulfils the condition), an observer with a node
of its own takes the time of the stop message, and of the event by which the node tells of its safe
value. Faults at random moments hit a tuner that does nothing but set another value again and again,
from its start on; unsafe is a node that is left with any of these.

What the guard costs is told by its processor time in a run without a fault, and by the time of
evaluations with and without it, in turn.
"""

import argparse
import contextlib
import multiprocessing
import os
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from common import BENCHMARKS, provenance, result_parser, table, write_result
from rcl_interfaces.msg import ParameterEvent
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.ros.guard.link import GuardLink
from bo_tuner.backends.ros.guard.plan import Plan
from bo_tuner.backends.ros.isolation import isolated_environment
from bo_tuner.backends.ros.parameters.nodes import NodeParameters
from bo_tuner.backends.ros.run_watch import RunWatch
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.study import strict_yaml
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import study_from_mapping
from bo_tuner.trials import Evaluation, Stage

EXAMPLE = BENCHMARKS.parent / "examples" / "unchanged_system"
STOP, SAFE, CROSSED = -0.125, 0.25, 0.5
KILLED, STOPPED, HUNG, BLIND = "killed", "stopped", "hung", "blind to the condition"
FULL = (KILLED, STOPPED, HUNG, BLIND)
LONGEST = 60.0
"""Time [s] within which each thing must happen."""
SEED = 1


def the_study(kind: str) -> Study:
    """Return the study of the example, with a stop message, safe parameters and runs of 1 s."""
    content = strict_yaml.parse((EXAMPLE / "study.yaml").read_text()).value
    content["run"]["after"] = [{"publish": {"topic": "/setpoint", "message": {"data": STOP}}}]
    content["run"]["end"] = {"after": 1.0}
    # A step to 1 rad crosses it.
    content["run"]["abort_when"] = f"abs(angle) > {CROSSED if kind == BLIND else 20}"
    content["park"] = {"parameters": {"kp": SAFE}}
    return study_from_mapping(content)


class Observer:
    """A node that takes the times at which it hears of things."""

    def __init__(self) -> None:
        self._context = Context()
        rclpy.init(context=self._context)
        self.node = Node("observer", context=self._context)
        self._times: dict[str, list[float]] = {name: [] for name in ("start", "stop", "safe")}
        self._crossed: list[float] = []
        self.node.create_subscription(Float64, "/setpoint", self._hear_setpoint, 10)
        self.node.create_subscription(ParameterEvent, "/parameter_events", self._hear_event, 10)
        self.node.create_subscription(JointState, "/joint_states", self._hear_angle, 10)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def forget(self) -> None:
        """Forget all that was heard."""
        self._crossed.clear()
        for times in self._times.values():
            times.clear()

    def first(self, what: str, since: float) -> float:
        """Wait for something after a time; returns its time [s]."""
        deadline = time.monotonic() + LONGEST
        while not (found := [t for t in self.heard(what) if t > since]):
            if time.monotonic() > deadline:
                return float("inf")
            time.sleep(0.0005)
        return found[0]

    def heard(self, what: str) -> list[float]:
        """Return the times [s] at which something was heard so far."""
        return list(self._crossed if what == "crossed" else self._times[what])

    def is_alone(self) -> bool:
        """Whether nobody is known any more who may send a set-point."""
        return self.node.count_publishers("/setpoint") == 0

    def close(self) -> None:
        """Leave."""
        self._over.set()
        self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def _hear_setpoint(self, message: Float64) -> None:
        what = {1.0: "start", STOP: "stop"}.get(message.data)
        if what is not None:
            self._times[what].append(time.monotonic())

    def _hear_event(self, event: ParameterEvent) -> None:
        for item in event.changed_parameters:
            if item.name == "kp" and parameter_value_to_python(item.value) == SAFE:
                self._times["safe"].append(time.monotonic())

    def _hear_angle(self, message: JointState) -> None:
        if message.position and abs(message.position[0]) > CROSSED:
            self._crossed.append(time.monotonic())

    def _spin(self) -> None:
        while not self._over.is_set():
            self._executor.spin_once(timeout_sec=0.05)


def work(kind: str, folder: str) -> None:
    """Be a tuner with a fault of a kind, evaluating until the end."""
    os.setsid()
    study = the_study(kind)
    backend = RosBackend(study, Path(folder), attach=True, guard=True, halt=lambda text: None)
    if kind == BLIND:
        RunWatch._holds = lambda *_: None  # type: ignore[method-assign]
        RunWatch._holds_late = lambda *_: False  # type: ignore[method-assign]
    if kind == HUNG:
        hang = threading.Event()
        signal.signal(signal.SIGUSR1, lambda *_: hang.set() or time.sleep(5.0))  # type: ignore[func-returns-value]
    backend.open()
    index = 0
    while True:
        parameters = {"kp": 2.0, "ki": 0.0, "kd": 0.1}
        outcome = backend.outcome(Evaluation(0, index, Stage.DRAWN, parameters, {}, index))
        if index == 0 and kind != BLIND and not outcome.complete:
            raise SystemExit(f"error: {outcome.reason}")
        index += 1


def full_runs(repetitions: int, observer: Observer, rng: np.random.Generator) -> dict[str, Any]:
    """Faults in full runs; times [s] until the stop message and until the safe values."""
    spawn = multiprocessing.get_context("spawn")
    found: dict[str, Any] = {}
    for kind in FULL:
        stop, safe, unsafe = [], [], 0
        for _ in range(repetitions):
            with tempfile.TemporaryDirectory() as folder:
                observer.forget()
                tuner = spawn.Process(target=work, args=(kind, folder), daemon=True)
                tuner.start()
                # The first run has what belongs to the start; for a blind tuner it is the last one.
                began = start_of(1 if kind == BLIND else 2, observer, tuner)
                if kind == BLIND:
                    event = observer.first("crossed", began)
                else:
                    time.sleep(float(rng.uniform(0.05, 0.8)))
                    event = time.monotonic()
                    signum = {KILLED: signal.SIGKILL, STOPPED: signal.SIGSTOP}.get(
                        kind, signal.SIGUSR1
                    )
                    os.kill(tuner.pid or 0, signum)
                stop.append(observer.first("stop", event) - event)
                safe.append(observer.first("safe", event) - event)
                unsafe += not np.isfinite([stop[-1], safe[-1]]).all()
                tuner.kill()
                tuner.join()
                wait_for_guards(folder)
                # One that was killed is in the graph until its lease ends.
                if not wait_for(observer.is_alone):
                    raise SystemExit("error: a tuner that was killed is in the graph still")
        found[kind] = {
            "faults": repetitions,
            "unsafe": unsafe,
            "stop": {"median": statistics.median(stop), "worst": max(stop)},
            "safe": {"median": statistics.median(safe), "worst": max(safe)},
        }
    return found


def start_of(run: int, observer: Observer, tuner: BaseProcess) -> float:
    """Wait for a run of a tuner, from 1 on; return its start [s], or end the script without one."""

    def begun() -> int:
        return len(observer.heard("start"))

    if wait_for(lambda: begun() >= run or not tuner.is_alive()) and begun() >= run:
        return observer.heard("start")[run - 1]
    state = "goes on" if tuner.is_alive() else f"ended with exit code {tuner.exitcode}"
    raise SystemExit(
        f"error: {begun()} of {run} runs began within {LONGEST:g} s; the tuner {state}"
    )


def wait_for_guards(folder: str) -> None:
    """Wait until the guard whose log is in a folder has ended."""
    deadline = time.monotonic() + LONGEST
    while guards(folder) and time.monotonic() < deadline:
        time.sleep(0.01)


def guards(folder: str) -> list[int]:
    """Find the guards that log in a folder."""
    found = []
    for path in Path("/proc").glob("[0-9]*/fd/2"):
        with contextlib.suppress(OSError):
            if str(path.readlink()).startswith(folder) and path.parents[1].name.isdigit():
                command = (path.parents[1] / "cmdline").read_bytes()
                if b"bo_tuner.backends.ros.guard" in command:
                    found.append(int(path.parents[1].name))
    return found


class Keeper(Node):
    """Keeps parameters, and does nothing else."""

    def __init__(self, context: Context) -> None:
        super().__init__("pid", context=context)
        for name, value in (("kp", 0.5), ("ki", 0.0), ("kd", 0.02)):
            self.declare_parameter(name, value)


def set_again_and_again(folder: str) -> None:
    """Be a tuner that sets values of trials, under a guard."""
    os.setsid()
    study = values_only()
    tuner = TunerNode(None, [], lambda: None)
    plan = Plan.of(study)
    link = GuardLink(tuner, plan, Path(folder))
    parameters = NodeParameters(tuner, {"pid": "pid"}, {"pid": ["kp"]})
    tuner.wait_until(parameters.clients["pid"].is_ready, LONGEST)
    link.begin(study, [])
    value = 1.0
    while True:
        parameters.assign("pid", {"kp": value})
        value = 1.0 + (value + 0.125) % 1.0


def values_only() -> Study:
    """Return the study of a node that only keeps parameters: nothing is to be stopped."""
    content = strict_yaml.parse((EXAMPLE / "study.yaml").read_text()).value
    for key in ("after", "abort_when"):
        content["run"].pop(key, None)
    content["park"] = {"parameters": {"kp": SAFE}}
    return study_from_mapping(content)


def random_faults(count: int, rng: np.random.Generator) -> dict[str, Any]:
    """Faults at random moments, from the start of a tuner on."""
    context = Context()
    rclpy.init(context=context)
    keeper = Keeper(context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(keeper)
    over = threading.Event()

    def spin() -> None:
        while not over.is_set():
            executor.spin_once(timeout_sec=0.05)

    thread = threading.Thread(target=spin)
    thread.start()
    # Forked from a process that has all imports, so that they are not what is killed.
    fork = multiprocessing.get_context("forkserver")
    fork.set_forkserver_preload(["__main__"])
    unsafe, touched, delays = 0, 0, []
    for index in range(count):
        keeper.set_parameters([rclpy.Parameter("kp", value=0.5)])
        with tempfile.TemporaryDirectory() as folder:
            tuner = fork.Process(target=set_again_and_again, args=(folder,), daemon=True)
            tuner.start()
            if index % 2:
                wait_for(lambda: keeper.get_parameter("kp").value >= 1.0)
                time.sleep(float(rng.uniform(0.0, 0.3)))
            else:
                time.sleep(float(rng.uniform(0.0, 4.0)))
            os.kill(tuner.pid or 0, signal.SIGKILL if index % 4 < 2 else signal.SIGSTOP)
            begun = time.monotonic()
            is_touched = keeper.get_parameter("kp").value >= 1.0
            touched += is_touched
            # A request may be under way.
            time.sleep(0.1)
            unsafe += not wait_for(lambda: keeper.get_parameter("kp").value < 1.0)
            if is_touched:
                delays.append(time.monotonic() - begun)
            tuner.kill()
            tuner.join()
            wait_for_guards(folder)
            unsafe += keeper.get_parameter("kp").value >= 1.0
    over.set()
    thread.join()
    executor.shutdown()
    keeper.destroy_node()
    context.try_shutdown()
    return {"faults": count, "with values of a trial": touched, "unsafe": unsafe}


def wait_for(condition: Callable[[], bool]) -> bool:
    """Wait until a condition holds; whether it does in time."""
    deadline = time.monotonic() + LONGEST
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.0005)
    return True


def cost(repetitions: int) -> dict[str, Any]:
    """Processor time of a guard, and what it adds to an evaluation and to the start."""
    seconds: dict[bool, list[float]] = {False: [], True: []}
    start: dict[bool, list[float]] = {False: [], True: []}
    share = []
    for index in range(repetitions):
        for guarded in (False, True) if index % 2 else (True, False):
            with tempfile.TemporaryDirectory() as folder:
                begun = time.monotonic()
                backend = RosBackend(the_study(KILLED), Path(folder), attach=True, guard=guarded)
                backend.open()
                start[guarded].append(time.monotonic() - begun)
                used = [_processor_time(pid) for pid in guards(folder)]
                begun = time.monotonic()
                for number in range(5):
                    planned = Evaluation(
                        0, number, Stage.DRAWN, {"kp": 2.0, "ki": 0.0, "kd": 0.1}, {}, 1
                    )
                    outcome = backend.outcome(planned)
                    if not outcome.complete:
                        raise SystemExit(f"error: {outcome.reason}")
                elapsed = time.monotonic() - begun
                seconds[guarded].append(elapsed / 5)
                share += [
                    (_processor_time(pid) - before) / elapsed
                    for pid, before in zip(guards(folder), used, strict=True)
                ]
                backend.close()
    ratios = [b / a for a, b in zip(seconds[False], seconds[True], strict=True)]
    added = [b - a for a, b in zip(start[False], start[True], strict=True)]
    return {
        "share of a core": _spread(share),
        "time of an evaluation, with to without": _spread(ratios),
        "added to the start [s]": _spread(added),
    }


def _spread(values: list[float]) -> dict[str, float]:
    return {"median": statistics.median(values), "least": min(values), "largest": max(values)}


def _processor_time(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextlib.contextmanager
def machine() -> Iterator[list[subprocess.Popen]]:
    """Motor and controller of the example, as processes."""
    nodes = [
        subprocess.Popen([sys.executable, EXAMPLE / f"{name}_node.py"], stdout=subprocess.DEVNULL)
        for name in ("motor", "pid")
    ]
    try:
        yield nodes
    finally:
        for node in nodes:
            node.kill()
            node.wait()


def main() -> None:
    """Run the faults and write the result."""
    parser = result_parser(__doc__ or "", "guard_faults.json")
    parser.add_argument("--repetitions", type=int, default=30, help="full runs of each kind")
    parser.add_argument("--faults", type=int, default=1000, help="faults at random moments")
    parser.add_argument("--domain", type=int, default=87, help="ROS domain")
    arguments: argparse.Namespace = parser.parse_args()
    os.environ.update(isolated_environment(arguments.domain))
    state = tempfile.mkdtemp()
    os.environ["XDG_STATE_HOME"] = state
    result: dict[str, Any] = {"provenance": provenance(), "seed": SEED}
    rng = np.random.default_rng(SEED)
    try:
        with machine():
            observer = Observer()
            try:
                result["cost"] = cost(max(arguments.repetitions // 3, 3))
                result["full"] = full_runs(arguments.repetitions, observer, rng)
            finally:
                observer.close()
        result["random"] = random_faults(arguments.faults, rng)
    finally:
        shutil.rmtree(state)
    write_result(arguments.result, result)
    rows = [
        [kind, r["faults"], r["unsafe"], *(r[k][s] for k in ("stop", "safe") for s in r[k])]
        for kind, r in result["full"].items()
    ]
    header = ["fault", "times", "unsafe", "stop: median [s]", "worst", "safe: median [s]", "worst"]
    print(table(header, rows))
    print(result["random"], result["cost"])


if __name__ == "__main__":
    main()
