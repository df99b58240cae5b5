"""200 foreign changes of any parameter of any node, at random moments: wrong rows, and undetected.

Plant and controller run on their own, and the tuner's backend is attached to them: evaluations with
other parameters, contexts and seeds each time, recorded in a journal. Meanwhile somebody else sets
a parameter, drawn from all that the nodes have, to another valid value, and in every other case
sets it back at once; the next change comes when this one is found, after a random time.

Of the rows on record that say complete, each is run again in process, where nobody else is; a row
is wrong if it differs in a bit. A change is undetected if none of the next evaluations failed with
the parameter's name.
"""

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from common import opened, provenance, result_parser, table, write_result
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from threadpoolctl import threadpool_limits

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.ros.isolation import DomainClaim, isolated_environment
from bo_tuner.storage.journal import Journal
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import load_study, study_from_mapping, study_to_mapping
from bo_tuner.trials import Evaluation, EvaluationState, Stage
from milling_plant.settings import default_settings as plant_defaults
from mpc_controller.settings import default_settings as controller_defaults

SEED = 1
NODES = ("milling_plant", "mpc_controller")
ROS_ARGUMENTS = ["--ros-args", "-r", "__ns:=/soak"]
LONGEST_PAUSE = 0.6
"""Longest time [s] from a change that was found to the next one: some evaluations."""
FOUND_WITHIN = 4
"""Evaluations that begin or end after a change of which one must name it."""
DEADLINE = 60.0


class Stranger:
    """Somebody else with a node in the same domain."""

    def __init__(self, domain: int) -> None:
        self._context = Context()
        rclpy.init(args=ROS_ARGUMENTS, context=self._context, domain_id=domain)
        self._node = Node("stranger", context=self._context, start_parameter_services=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._clients: dict[str, Any] = {}

    def names(self, node: str) -> list[str]:
        """All parameters of a node."""
        answer = self._call(ListParameters, f"{node}/list_parameters", ListParameters.Request())
        return sorted(answer.result.names)

    def value(self, node: str, name: str) -> object:
        """Value of a parameter."""
        request = GetParameters.Request(names=[name])
        answer = self._call(GetParameters, f"{node}/get_parameters", request)
        return parameter_value_to_python(answer.values[0])

    def set(self, node: str, name: str, value: object) -> bool:
        """Set a parameter; False if it is refused."""
        message = Parameter(name, value=value).to_parameter_msg()
        request = SetParametersAtomically.Request(parameters=[message])
        service = f"{node}/set_parameters_atomically"
        return self._call(SetParametersAtomically, service, request).result.successful

    def close(self) -> None:
        """Leave ROS."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _call(self, kind: type, name: str, request: object) -> Any:
        client = self._clients.setdefault(name, None) or self._node.create_client(kind, name)
        self._clients[name] = client
        client.wait_for_service(DEADLINE)
        # A server may take the first request before it knows where the answer goes.
        for _ in range(round(DEADLINE)):
            future, end = client.call_async(request), time.monotonic() + 1.0
            while not future.done() and time.monotonic() < end:
                self._executor.spin_once(timeout_sec=0.05)
            if future.done():
                return future.result()
        raise SystemExit(f"error: {name} does not answer")


def other_value(value: Any, rng: np.random.Generator) -> Any:
    """Another value of the same type, not far from this one."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + int(rng.integers(1, 5)) * int(rng.choice([-1, 1]))
    if isinstance(value, float):
        return value * float(rng.uniform(0.5, 1.5)) + float(rng.choice([0.0, 0.01]))
    if isinstance(value, str):
        return {"measured": "modelled", "modelled": "measured"}.get(value, f"{value}_2")
    return [other_value(item, rng) for item in value]


def planned(study: Study, rng: np.random.Generator) -> Iterator[Evaluation]:
    """Plan evaluations without end."""
    space, contexts = study.search_space(), study.context_space()
    number = 0
    while True:
        parameters = space.to_parameters(space.latin_hypercube(1, rng)[0])
        context = contexts.to_dict(contexts.draw(1, rng)[0])
        seed = int(rng.integers(2**31))
        yield Evaluation(number, 0, Stage.DRAWN, parameters, context, seed)
        number += 1


class Soak:
    """Evaluations in this thread, and the stranger in another."""

    def __init__(self, study: Study, domain: int, changes: int) -> None:
        self._study = study
        self._rng = np.random.default_rng(SEED)
        self._stranger = Stranger(domain)
        self._count = changes
        self._failure: BaseException | None = None
        self.done = threading.Event()
        self.outcomes: list[tuple[EvaluationState, str]] = []
        self.undetected: list[str] = []
        self.changed: Counter[str] = Counter()
        self.refused = 0

    def run(self) -> None:
        """Change parameters; for a thread."""
        try:
            names = [(node, n) for node in NODES for n in self._stranger.names(node)]
            self._wait_for(1)
            while sum(self.changed.values()) < self._count:
                time.sleep(self._rng.uniform(0.0, LONGEST_PAUSE))
                node, name = names[self._rng.integers(len(names))]
                self._change(node, name)
        except BaseException as error:
            self._failure = error
        finally:
            self.done.set()

    def close(self) -> None:
        """Leave ROS, and raise what has ended the thread."""
        self._stranger.close()
        if self._failure is not None:
            raise self._failure

    def _change(self, node: str, name: str) -> None:
        before = self._stranger.value(node, name)
        value = other_value(before, self._rng)
        seen = len(self.outcomes)
        if value == before or not self._stranger.set(node, name, value):
            self.refused += 1
            return
        if self._rng.random() < 0.5:
            self._stranger.set(node, name, before)
        self.changed[f"{node}.{name}"] += 1
        text = f"parameter {name} is "
        for count in range(1, FOUND_WITHIN + 1):
            self._wait_for(seen + count)
            state, reason = self.outcomes[seen + count - 1]
            if state is EvaluationState.FAILED and text in reason:
                return
        self.undetected.append(f"{node}.{name}: {before} -> {value}")

    def _wait_for(self, count: int) -> None:
        deadline = time.monotonic() + DEADLINE
        while len(self.outcomes) < count:
            if time.monotonic() > deadline:
                raise SystemExit(f"error: no evaluation for {DEADLINE:g} s")
            time.sleep(0.005)


def wrong_rows(study: Study, evaluations: tuple[Evaluation, ...]) -> list[str]:
    """Run complete rows again in process; those that differ."""
    wrong = []
    with threadpool_limits(1), opened(InProcessBackend(study)) as backend:
        for row in evaluations:
            if row.outcome.state is EvaluationState.COMPLETE:
                expected = backend.outcome(row).metrics
                if dict(row.outcome.metrics) != dict(expected):
                    wrong.append(f"{row.trial}: {row.outcome.metrics}, expected {expected}")
    return wrong


def short_study() -> Study:
    """Take the full study in short cuts, without any measured time."""
    mapping = study_to_mapping(load_study("full"))
    mapping["nodes"]["controller"]["parameters"] = {"return_time": "modelled"}
    mapping["nodes"]["plant"]["parameters"] = {"samples_per_level": 20, "command_timeout": 2.0}
    return study_from_mapping(mapping)


def soak(changes: int, folder: Path, domain: int) -> dict[str, Any]:
    """Change parameters under a run, and look at its record."""
    study = short_study()
    backend = RosBackend(study, folder, attach=True, ros_arguments=ROS_ARGUMENTS)
    states: Counter[str] = Counter()
    begin = time.perf_counter()
    with opened(backend):
        changer = Soak(study, domain, changes)
        stranger = threading.Thread(target=changer.run)
        try:
            stranger.start()
            with Journal(folder / "journal.sqlite", {"study": study.name}) as journal:
                for plan in planned(study, np.random.default_rng(SEED)):
                    if changer.done.is_set():
                        break
                    (evaluation,) = backend.run([plan])
                    journal.record_evaluation(evaluation)
                    states[str(evaluation.outcome.state)] += 1
                    changer.outcomes.append((evaluation.outcome.state, evaluation.outcome.reason))
        finally:
            stranger.join()
            changer.close()
    wrong = wrong_rows(study, read_journal(folder / "journal.sqlite").evaluations)
    settings: Mapping[str, Mapping[str, Any]] = {
        "milling_plant": asdict(plant_defaults()),
        "mpc_controller": asdict(controller_defaults()),
    }
    own = {f"{node}.{name}" for node, values in settings.items() for name in values}
    return {
        "seed": SEED,
        "changes": sum(changer.changed.values()),
        "refused_by_the_nodes": changer.refused,
        "parameters_changed": len(changer.changed),
        "parameters_of_the_nodes": len(own),
        "changes_by_parameter": dict(sorted(changer.changed.items())),
        "evaluations": dict(states),
        "wrong_rows": len(wrong),
        "undetected_changes": len(changer.undetected),
        "wrong": wrong,
        "undetected": changer.undetected,
        "seconds": time.perf_counter() - begin,
        "load_average": os.getloadavg(),
    }


def main() -> None:
    """Run and report; exit code 1 if a row is wrong or a change undetected."""
    parser = result_parser(__doc__, "integrity_soak.json")
    parser.add_argument("--changes", type=int, default=200, help="(default: %(default)s)")
    arguments = parser.parse_args()
    origin = provenance()
    # The namespace of the nodes is claimed by the backend; this keeps other tuners away.
    claim = DomainClaim("/")
    os.environ |= isolated_environment(claim.domain)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ["ROS_LOG_DIR"] = name
        with (folder / "nodes").open("w") as log:
            nodes = [
                subprocess.Popen(
                    [sys.executable, "-m", node, *ROS_ARGUMENTS], stdout=log, stderr=log
                )
                for node in NODES
            ]
        try:
            time.sleep(2.0)
            result = soak(arguments.changes, folder, claim.domain)
        finally:
            for node in nodes:
                node.send_signal(signal.SIGTERM)
            for node in nodes:
                node.wait()
            claim.release()
    write_result(arguments.result, {"provenance": origin} | result)
    figures = ("changes", "parameters_changed", "wrong_rows", "undetected_changes", "seconds")
    print(table(figures, [[result[name] for name in figures]]))
    if result["wrong_rows"] or result["undetected_changes"]:
        sys.exit(1)


if __name__ == "__main__":
    main()
