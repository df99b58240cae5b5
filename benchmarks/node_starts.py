"""What it takes to start a node anew with the values of another trial (``at_start``).

The controller of ``examples/unchanged_system`` is started with its gains, and gets others in each
evaluation. Timed is each from the order to end the process, and from when it has ended, until
the first step of the next run is performed: with the new process up, discovered, read back and
publishing. Beside it stands an evaluation that needs no start, and what a process of the same
interpreter needs by itself, from its start until it has made a node.
"""

import contextlib
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from common import BENCHMARKS, provenance, result_parser, table, write_result

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.ros.isolation import isolated_environment
from bo_tuner.backends.ros.procedure import Procedure
from bo_tuner.backends.ros.started_nodes import StartedNodes
from bo_tuner.study import strict_yaml
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import study_from_mapping
from bo_tuner.trials import Evaluation, EvaluationState, Stage

EXAMPLE = BENCHMARKS.parent / "examples" / "unchanged_system"
ALONE = "import rclpy; rclpy.init(); rclpy.create_node('alone')"
DOMAIN = 89
RUN = 0.5
"""Length of a run [s]."""


def the_study() -> Study:
    """Return the study of the example, whose nodes are started; runs have no steps before them."""
    content = strict_yaml.parse((EXAMPLE / "study.yaml").read_text()).value
    for node in ("pid", "motor"):
        command = f"'{sys.executable}' '{EXAMPLE / f'{node}_node.py'}'"
        content["nodes"][node] = {"node": node, "command": command}
    content["nodes"]["pid"]["at_start"] = True
    content["run"] |= {"before": [], "end": {"after": RUN}}
    del content["run"]["abort_when"]
    for spec in content["signals"].values():
        spec.pop("largest_gap", None)
    content["signals"]["setpoint"]["minimum_messages"] = 0
    return study_from_mapping(content)


@contextlib.contextmanager
def noted(cls: type[Any], name: str, note: Callable[[str, float], None]) -> Iterator[None]:
    """Note when a method of a class is called, and when it has returned."""
    method = getattr(cls, name)

    def timed(*arguments: Any) -> Any:
        note("called", time.monotonic())
        try:
            return method(*arguments)
        finally:
            note("returned", time.monotonic())

    setattr(cls, name, timed)
    try:
        yield
    finally:
        setattr(cls, name, method)


def evaluations(count: int) -> dict[str, list[float]]:
    """Evaluate with other gains each time, and as often with the same; returns the times [s]."""
    times: dict[str, list[float]] = {"whole": [], "new": [], "evaluation": [], "same": []}
    latest: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        backend = RosBackend(the_study(), Path(folder))
        stack.callback(backend.close)
        backend.open()
        stack.enter_context(
            noted(StartedNodes, "stop_one", lambda what, at: latest.update({f"end {what}": at}))
        )
        stack.enter_context(
            noted(Procedure, "perform", lambda what, at: latest.update({f"run {what}": at}))
        )
        for index in range(2 * count):
            gains = {"kp": 1.0 + 0.01 * (index // 2), "ki": 0.0, "kd": 0.2}
            began = time.monotonic()
            outcome = backend.outcome(Evaluation(index, 0, Stage.DRAWN, gains, {}, 1))
            took = time.monotonic() - began
            if outcome.state is not EvaluationState.COMPLETE:
                raise SystemExit(f"an evaluation is {outcome.state}: {outcome.reason}")
            if outcome.notes.starts != (index % 2 == 0):
                raise SystemExit(f"{outcome.notes.starts} starts in evaluation {index}")
            if index % 2:
                times["same"].append(took)
                continue
            times["evaluation"].append(took)
            times["whole"].append(latest["run called"] - latest["end called"])
            times["new"].append(latest["run called"] - latest["end returned"])
    return times


def alone(count: int) -> list[float]:
    """Return the times [s] of processes that make a node, and end."""
    found = []
    environment = os.environ | isolated_environment(DOMAIN)
    for _ in range(count):
        began = time.monotonic()
        subprocess.run([sys.executable, "-c", ALONE], check=True, env=environment)
        found.append(time.monotonic() - began)
    return found


def summary(values: list[float]) -> dict[str, float]:
    """Return the median, the least and the largest."""
    return {"median": statistics.median(values), "least": min(values), "largest": max(values)}


def main() -> None:
    """Measure and report."""
    parser = result_parser(__doc__, "node_starts.json")
    parser.add_argument("--starts", type=int, default=30, help="(default: %(default)s)")
    arguments = parser.parse_args()
    about = provenance()
    times = evaluations(arguments.starts)
    processes = alone(arguments.starts)
    seconds = {name: summary(values) for name, values in times.items()}
    seconds["alone"] = summary(processes)
    result = {
        "provenance": about,
        "starts": arguments.starts,
        "run": RUN,
        "seconds": seconds,
    }
    write_result(arguments.result, result)
    rows = [(name, *(f"{value:.3f}" for value in s.values())) for name, s in seconds.items()]
    print(table(("s", "median", "least", "largest"), rows))


if __name__ == "__main__":
    main()
