"""Evaluations on ROS 2 nodes, which the backend starts, watches, and restarts when one is lost."""

import dataclasses
import os
from collections.abc import Callable, Mapping
from pathlib import Path

from rclpy.context import Context

from bo_tuner.backends.protocol import ROS, SequentialBackend
from bo_tuner.backends.ros.isolation import DomainClaim, isolated_environment
from bo_tuner.backends.ros.procedure import Procedure
from bo_tuner.backends.ros.processes import NodeProcess, stop_all
from bo_tuner.backends.ros.study_client import LostError, RefusedError, StudyClient
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.metrics.collect import Collector, one_line
from bo_tuner.metrics.recording import (
    NOTHING_RECORDED,
    FailedRunError,
    Recording,
    signal_sources,
)
from bo_tuner.metrics.source import MetricSource
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, EvaluationState, Outcome

DISCOVERY_TIMEOUT = 20.0
ATTACH_TIMEOUT = 5.0
HIGHEST_DOMAIN = 232
LEASE = 3.0
"""Time [s] after which the discovery profile has forgotten a killed node for sure."""
LOOK_AROUND = 1.0
"""Time [s] to discover nodes, or another tuner, that run already."""


class RosBackend(SequentialBackend):
    """Runs evaluations on the study's nodes.

    Parameters
    ----------
    study
        The study.
    log_directory
        Takes what started nodes print.
    attach
        Use nodes that run already instead of starting them. They are looked for in the domain
        and with the discovery settings of the environment, and have in the end the parameters
        that they had before.
    ros_arguments
        ``--ros-args`` for the tuner's node and, as far as they are remappings of the namespace,
        for the nodes that it starts.
    interrupted
        Asked while waiting; raises what shall end the wait.
    sources
        Where metrics come from, unless as the study says; by name.

    Attributes
    ----------
    processes
        The started nodes by their key in the study.
    """

    name = ROS

    def __init__(
        self,
        study: Study,
        log_directory: Path,
        *,
        attach: bool = False,
        ros_arguments: list[str] | None = None,
        interrupted: Callable[[], None] = lambda: None,
        sources: Mapping[str, MetricSource] | None = None,
    ) -> None:
        self._study = study
        signals = signal_sources(study, lambda: self._recording)
        self._collector = Collector(study, {**signals, **(sources or {})})
        self._log_directory = log_directory
        self._attach = attach
        self._ros_arguments = ros_arguments or []
        self._namespace = _namespace(self._ros_arguments)
        self._interrupted = interrupted
        self._claim: DomainClaim | None = None
        self._client: StudyClient | None = None
        self._procedure: Procedure | None = None
        self._found: dict[str, dict[str, object]] = {}
        self.processes: dict[str, NodeProcess] = {}

    def open(self) -> None:
        """Start the nodes, unless attached, and wait until they are discovered.

        Raises
        ------
        BackendError
            If another tuner is at work on these nodes, nodes to be started run already, one
            cannot be started, or one does not appear in time.
        StudyError
            If a node refuses its constant parameters, the study does not say how to start it, or
            a topic or service of its run is not there.
        """
        given = _domain_of_environment()
        # Without a domain in the environment, nodes that run already are in 0.
        self._claim = DomainClaim(self._namespace, 0 if self._attach and given is None else given)
        if not self._attach:
            # The middleware reads the environment of the process, in this one too.
            os.environ.update(isolated_environment(self._claim.domain))
        os.environ.setdefault("ROS_LOG_DIR", str(self._log_directory))
        client = StudyClient(self._study, self._claim.domain, self._ros_arguments, self._watch)
        self._client = client
        try:
            if not self._attach:
                if given is not None:
                    self._refuse_running_nodes(client)
                self._start_processes()
            client.wait_for_nodes(ATTACH_TIMEOUT if self._attach else DISCOVERY_TIMEOUT)
            if self._attach:
                # That the nodes are discovered does not mean that another tuner is, too.
                client.spin_for(LOOK_AROUND)
            self._refuse_second_tuner(client)
            if self._attach:
                self._found = {key: client.get(key, self._names(key)) for key in self._study.nodes}
            self._set_constants(client)
            if self._study.run is not None:
                self._procedure = Procedure(self._study, self._study.run, client)
        except LostError as loss:
            hint = "; start it, or leave out --attach" if self._attach else ""
            raise BackendError(f"{loss}{hint}") from loss

    @property
    def context(self) -> Context:
        """ROS context of the tuner; there while the backend is open."""
        if self._client is None:
            raise BackendError("the backend is not open")
        return self._client.context

    def outcome(self, planned: Evaluation) -> Outcome:
        """Set parameters, run one evaluation, and collect its metrics.

        After a lost evaluation the nodes are started anew, or, attached, waited for.
        """
        client = self._client
        if client is None:
            raise BackendError("the backend is not open")
        assignments = self._study.assignments(planned.parameters, planned.context, planned.seed)
        try:
            for key in client.restarted():
                client.set(key, self._study.nodes[key].parameters)
            for key, values in assignments.items():
                client.set(key, values)
            said = self._run(client)
            if lost := client.restarted():
                raise LostError(f"{self._study.nodes[lost[0]].node} was started anew in the cut")
            result = self._collector.outcome(said)
        except (RefusedError, FailedRunError) as refusal:
            counts = self._recording.counts()
            return Outcome(EvaluationState.FAILED, {}, one_line(str(refusal)), counts)
        except LostError as loss:
            reason = one_line(f"{loss}{self._recover(client)}")
            return Outcome(EvaluationState.LOST, {}, reason)
        ignored = {"ignored_results": str(client.results.take_ignored())}
        return dataclasses.replace(
            result, details={**result.details, **ignored, **self._recording.counts()}
        )

    def _run(self, client: StudyClient) -> dict[str, dict[str, object]]:
        """Run once; returns what nodes said of it, which those of a procedure do not."""
        if self._procedure is None:
            return client.run_cut()
        try:
            self._procedure.run()
        finally:
            # Without a result, a node that died in the run would go unnoticed.
            for key in self._study.nodes:
                client.expect_answer(key)
        return {}

    @property
    def _recording(self) -> Recording:
        """What was recorded of the last run."""
        return NOTHING_RECORDED if self._procedure is None else self._procedure.recording

    @property
    def nodes(self) -> list[str]:
        """Names of the study's nodes, relative to the namespace."""
        return [spec.node for spec in self._study.nodes.values()]

    def close(self) -> None:
        """End the started nodes, leave attached ones as they were found, and leave ROS."""
        stop_all(self.processes.values())
        self.processes.clear()
        if self._procedure is not None:
            self._procedure.close()
            self._procedure = None
        if self._client is not None:
            self._restore(self._client)
            self._client.close()
            self._client = None
        if self._claim is not None:
            self._claim.release()
            self._claim = None

    def _names(self, key: str) -> list[str]:
        """List the parameters of a node that the study sets."""
        study = self._study
        contexts = study.context_space()
        nominal = contexts.to_dict(contexts.nominal())
        of_evaluation = study.assignments(study.search_space().defaults, nominal, 0)
        return list(dict.fromkeys([*study.nodes[key].parameters, *of_evaluation.get(key, {})]))

    def _restore(self, client: StudyClient) -> None:
        """Restore attached nodes: a live one must not keep what an evaluation was run with."""
        found, self._found = self._found, {}
        client.forget_parameters()
        # A signal has its effect already, and must not leave the nodes half set.
        self._interrupted = lambda: None
        for key, values in found.items():
            try:
                client.set(key, values)
            except (RefusedError, LostError) as error:
                client.warn(f"{self._study.nodes[key].node} is not set back: {error}")

    def _watch(self) -> None:
        self._interrupted()
        for process in self.processes.values():
            if process.exit_reason is not None:
                raise LostError(process.exit_reason)

    def _start_processes(self) -> None:
        environment = {
            # A node computes small matrices: more threads would only get in each other's way.
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
            "ROS_LOG_DIR": str(self._log_directory),
        }
        for key, spec in self._study.nodes.items():
            if not (spec.package and spec.executable):
                raise StudyError(
                    "no package and executable; add them, or use --attach", ("nodes", key)
                )
            self.processes[key] = NodeProcess(
                spec.package,
                spec.executable,
                ["--ros-args", "-r", f"__ns:={self._namespace}"],
                environment,
                self._log_directory / f"{key}.log",
            )

    def _refuse_running_nodes(self, client: StudyClient) -> None:
        client.spin_for(LOOK_AROUND)
        absent = client.absent()
        running = [spec.node for key, spec in self._study.nodes.items() if key not in absent]
        if running:
            raise BackendError(
                f"{running[0]}: runs already in ROS domain {os.environ['ROS_DOMAIN_ID']}; "
                "use --attach, or leave ROS_DOMAIN_ID unset"
            )

    def _refuse_second_tuner(self, client: StudyClient) -> None:
        if not client.is_alone():
            raise BackendError(
                f"another tuner is at work as {client.full_name}; wait for it, or "
                "use another namespace or ROS_DOMAIN_ID"
            )

    def _set_constants(self, client: StudyClient) -> None:
        for key, spec in self._study.nodes.items():
            try:
                client.set(key, spec.parameters)
            except RefusedError as refusal:
                raise StudyError(str(refusal), ("nodes", key, "parameters")) from refusal

    def _recover(self, client: StudyClient) -> str:
        """Get the nodes back; returns what to add to the reason if that failed."""
        client.forget_parameters()
        processes = list(self.processes.values())
        # Stopped ones are no longer watched.
        self.processes.clear()
        stop_all(processes)
        try:
            if not self._attach:
                client.wait_until_gone(LEASE)
                self._start_processes()
            client.wait_for_nodes(DISCOVERY_TIMEOUT)
            if self._attach:
                # Of a node that was killed and is back, the graph tells bit by bit.
                client.spin_for(LOOK_AROUND)
                client.restarted()
            self._set_constants(client)
        except (LostError, BackendError, StudyError) as error:
            # The next evaluation will be lost in turn; three lost trials end the run.
            return f"; not recovered: {error}"
        return ""


def _domain_of_environment() -> int | None:
    given = os.environ.get("ROS_DOMAIN_ID", "")
    if not given:
        return None
    if not (given.isascii() and given.isdigit() and int(given) <= HIGHEST_DOMAIN):
        raise BackendError(
            f"ROS_DOMAIN_ID is {given!r}; expected a number from 0 to {HIGHEST_DOMAIN}"
        )
    return int(given)


def _namespace(ros_arguments: list[str]) -> str:
    for argument in reversed(ros_arguments):
        if argument.startswith("__ns:="):
            return argument.removeprefix("__ns:=")
    return "/"
