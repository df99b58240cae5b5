"""Evaluations on ROS 2 nodes, which the backend starts, watches, and restarts when one is lost."""

import contextlib
import os
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from functools import partial
from pathlib import Path

from rclpy.context import Context

from bo_tuner.backends.layers.layer import Layer, Run, stacked
from bo_tuner.backends.layers.rest import rested
from bo_tuner.backends.layers.setting_times import ramped, with_starts
from bo_tuner.backends.layers.suspension import Suspension, not_suspended
from bo_tuner.backends.layers.warm_up import warm_up_runs, warmed_up
from bo_tuner.backends.protocol import SequentialBackend
from bo_tuner.backends.ros.bare_run import BareRun
from bo_tuner.backends.ros.bringup import Bringup
from bo_tuner.backends.ros.clock import TOPIC as CLOCK
from bo_tuner.backends.ros.clock import check_wall_clock
from bo_tuner.backends.ros.errors import LostError
from bo_tuner.backends.ros.guard.link import GuardLink
from bo_tuner.backends.ros.guard.plan import GIVE_UP, Plan
from bo_tuner.backends.ros.guarded import Guarded
from bo_tuner.backends.ros.isolation import (
    DomainClaim,
    domain_of_environment,
    isolated,
    namespace_of,
)
from bo_tuner.backends.ros.left_safe import AtAbort, LeftSafe
from bo_tuner.backends.ros.opened import Opened
from bo_tuner.backends.ros.others import START
from bo_tuner.backends.ros.parameters.at_rest import take_over
from bo_tuner.backends.ros.parameters.previous import PreviousParameters
from bo_tuner.backends.ros.procedure import Procedure
from bo_tuner.backends.ros.safe_state import PARK_TIMEOUT, SafeState
from bo_tuner.backends.ros.started_nodes import StartedNodes
from bo_tuner.backends.ros.study_client import StudyClient
from bo_tuner.backends.ros.tuner_node import CALL_TIMEOUT, TunerNode
from bo_tuner.errors import BackendError
from bo_tuner.interruption import Interrupted
from bo_tuner.metrics.collect import Collector
from bo_tuner.metrics.message_rates import MessageRates
from bo_tuner.metrics.recording import NOTHING_RECORDED, Recording
from bo_tuner.metrics.signal_sources import signal_sources
from bo_tuner.processor_load import with_children
from bo_tuner.study.configuring import stays_in_force
from bo_tuner.study.parts import ROS
from bo_tuner.study.run import SIM
from bo_tuner.study.safe_values import safe_values
from bo_tuner.study.step_values import left_by_calls
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Outcome


class RosBackend(SequentialBackend):
    """Runs evaluations on the study's nodes.

    Attributes
    ----------
    at_nodes : callable
        Called with the tuner's node once the nodes are there, ahead of anything that is set.
    at_abort : callable
        Called with each evaluation whose run was aborted, by the tuner or the guard, its outcome,
        and what the signals said in the 5 s before, in messages.
    """

    name = ROS

    def __init__(
        self,
        study: Study,
        log_directory: Path,
        *,
        attach: bool = False,
        keep_parked: bool = True,
        run_log: Path | None = None,
        guard: bool = False,
        halt: Callable[[str], None] | None = None,
        ros_arguments: list[str] | None = None,
        interrupted: Callable[[], None] = lambda: None,
        worker: int = 1,
    ) -> None:
        super().__init__(study, *self._warmed_up(study))
        self._study = study
        self._collector = Collector(study)
        self._rates = MessageRates(study)
        self._entered = contextlib.ExitStack()
        self._log_directory = log_directory
        self._attach = attach
        self._restored = study if keep_parked else study.without_safe_parameters()
        self._run_log = run_log
        self._is_guarded = guard
        self._halt = halt
        self._guard: GuardLink | None = None
        self._ros_arguments = ros_arguments or []
        self._namespace = namespace_of(self._ros_arguments)
        self._interrupted = interrupted
        self.at_nodes: Callable[[TunerNode], None] = lambda tuner: None
        self.at_abort: AtAbort = lambda planned, outcome, latest: None
        self._claim: DomainClaim | None = None
        self._tuner: TunerNode | None = None
        self._client: StudyClient | None = None
        self._procedure: Procedure | None = None
        self._suspension = Suspension()
        self._previous: PreviousParameters | None = None
        self._while_open: Opened | None = None
        self._on_nodes: Run | None = None
        self._started = StartedNodes(study, self._namespace, log_directory, worker)

    def open(self) -> None:
        """Start the nodes, unless attached, and wait until they are discovered."""
        check_wall_clock()
        sources = signal_sources(self._study, lambda: self.recording, lambda: self._interrupted())
        self._collector = Collector(self._study, self._entered.enter_context(sources))
        given = domain_of_environment()
        tuner, client = self._enter(given)
        bringup = Bringup(
            self._study, tuner, client, self._started, self._suspension, attach=self._attach
        )
        try:
            if self._is_guarded:
                plan = Plan.of(self._study, attached=self._attach)
                self._guard = GuardLink(tuner, plan, self._log_directory, attached=self._attach)
            bringup.open(safe_values(self._study), look_around=given is not None)
            if self._guard is not None:
                self._guard.begin(self._study, self._ros_arguments)
            self.at_nodes(tuner)
            if self._attach:
                self._previous = PreviousParameters(self._restored, tuner, client.parameters)
                client.approach.announce = self._previous.announce
            safe, held = take_over(
                self._study,
                tuner,
                client.parameters,
                client.approach,
                self._previous,
                self._run_log or self._log_directory,
                is_repeat=self._run_log is not None,
            )
            staying = stays_in_force(self._study.configured_by_steps) if self._attach else ()
            run = self._study.run
            left = () if run is None else left_by_calls(run, self._study.parameters)
            for remark in (*client.parameters.take_remarks(), *staying, *left):
                tuner.warn(remark)
            if run is not None:
                restart = None if self._attach else bringup.restart
                self._procedure = Procedure(
                    self._study, run, tuner, client.parameters, restart, self._guard
                )
                client.start_values.between = self._procedure.forget_ended
                client.start_values.after = self._procedure.welcome
            safe_state = SafeState(
                self._study,
                tuner,
                client,
                safe,
                held,
                self._procedure,
                self._suspension,
                self._look,
            )
            self._while_open = Opened(
                self._study,
                tuner,
                client,
                self._started,
                bringup,
                self._suspension,
                held,
                self._procedure,
                self._previous,
                safe_state,
                self._look,
            )
            self._on_nodes = self._with_needs(self._while_open)
        except LostError as loss:
            hint = f" (--attach starts no node: {START})" if self._attach else ""
            raise BackendError(f"{loss}{hint}") from loss

    def _with_needs(self, opened: Opened) -> Run:
        """Return a run on the nodes with what they need around it, from inside to outside."""
        guarded = Guarded(opened, self._guard, self._halt)
        bare = BareRun(opened, guarded, self._collector, self._rates)
        client = opened.client
        return stacked(
            bare.run,
            ramped(client.approach.take_seconds),
            rested(bare.rest),
            guarded,
            LeftSafe(opened, guarded, lambda *said: self.at_abort(*said), attached=self._attach),
            with_starts(client.start_values.take_starts),
            # What the guard has ended is not repeated until somebody has looked at the machine.
            not_suspended(self._suspension, self._look, lambda: guarded.taken_over),
        )

    def _warmed_up(self, study: Study) -> Iterator[Layer]:
        """Yield the layer of a machine that needs to be warm."""
        if study.run is not None and (warm_up := study.run.warm_up) is not None:
            runs = warm_up_runs(study, warm_up.runs)
            yield warmed_up(runs, warm_up.after, self.outcome, lambda: self.after_extra_run())

    def _enter(self, domain: int | None) -> tuple[TunerNode, StudyClient]:
        """Claim a ROS domain, by number or any, and join it."""
        # Without a domain in the environment, nodes that run already are in 0.
        self._claim = DomainClaim(self._namespace, 0 if self._attach and domain is None else domain)
        if not self._attach:
            # The middleware reads the environment of the process, in this one too.
            self._entered.enter_context(isolated(self._claim.domain))
        os.environ.setdefault("ROS_LOG_DIR", str(self._log_directory))
        self._tuner = TunerNode(self._claim.domain, self._ros_arguments, self._watch)
        started = None if self._attach else self._started
        self._client = StudyClient(self._study, self._tuner, started)
        return self._tuner, self._client

    @property
    def context(self) -> Context:
        """ROS context of the tuner; there while the backend is open."""
        return self._opened.tuner.context

    def meet_nodes(self) -> None:
        """Wait until the nodes send here all that this process has subscribed to so far."""
        for key in self._study.nodes:
            # One that is silent is lost in the next evaluation.
            with contextlib.suppress(LostError):
                self._opened.client.presence.meet(key, time.monotonic() + CALL_TIMEOUT)

    def park(self) -> list[str]:
        """Set the safe parameters on all nodes and read them back."""
        return self._opened.safe_state.park()

    def recall(self, evaluations: Iterable[Evaluation]) -> None:
        """Take note of how often messages came in the first evaluations on record."""
        for evaluation in evaluations:
            self._rates.note(evaluation.outcome)

    def outcome(self, planned: Evaluation) -> Outcome:
        """Run one evaluation on the nodes, and leave them safe.

        After a lost evaluation the nodes are started anew, or, attached, waited for.
        """
        if self._on_nodes is None:
            raise BackendError("the backend is not open")
        outcome = self._on_nodes(planned)
        self._rates.note(outcome)
        return outcome

    def start_anew(self) -> None:
        """Have nodes that take values only at their start begin the next evaluation with one."""
        self._opened.client.start_values.forget_all()

    @property
    def _opened(self) -> Opened:
        if self._while_open is None:
            raise BackendError("the backend is not open")
        return self._while_open

    @property
    def recording(self) -> Recording:
        """What was recorded of the last run."""
        return NOTHING_RECORDED if self._procedure is None else self._procedure.recording

    @property
    def processes(self) -> list[int]:
        """Those of the nodes that the tuner has started; attached ones may be anywhere."""
        return list(with_children(p.pid for p in self._started.processes.values()))

    @property
    def nodes(self) -> list[str]:
        """Names of the study's nodes, relative to the namespace."""
        return [spec.node for spec in self._study.nodes.values()]

    @property
    def topics(self) -> list[str]:
        """Topics of the study's signals, relative to the namespace or absolute."""
        run = self._study.run
        clock = [CLOCK] if run is not None and run.clock == SIM else []
        return [*dict.fromkeys(spec.topic for spec in self._study.signals.values()), *clock]

    def close(self) -> None:
        """Leave the machine safe, end the started nodes, restore attached ones, and leave ROS.

        An attached node has its previous parameters in the end, but for safe ones that the study
        names and that are to be kept; which these are is said.
        """
        problems: list[str] = []
        undone: list[str] = []
        at_once = self._is_interrupted()
        # A signal has its effect already, and must not leave the nodes half set.
        self._interrupted = lambda: None
        with contextlib.ExitStack() as stack:
            # Callbacks run in reverse order, and each of them whatever the others raise.
            stack.callback(self._let_go)
            stack.callback(self._entered.close)
            if self._claim is not None:
                stack.callback(self._claim.release)
            if self._tuner is not None:
                stack.callback(self._tuner.close)
            if self._procedure is not None:
                stack.callback(self._procedure.close)
            stack.callback(self._started.stop)
            if self._tuner is not None and self._client is not None:
                stack.enter_context(self._tuner.watched_by(self._look))
                if self._guard is not None:
                    stack.callback(self._let_go_of_guard, self._guard, problems)
                if self._previous is not None:
                    stack.callback(self._restore, self._previous, problems)
                    stack.callback(self._client.parameters.forget_all)
                if self._procedure is not None:
                    stack.callback(self._leave, self._tuner, self._procedure, undone)
                    park = partial(self._park_last, at_once)
                    stack.callback(self._warn_of, self._tuner, park)
        if problems:
            problems.append("the next command with --attach does that")
            if self._is_guarded:
                problems.append(
                    f"until then its guard tries to set the safe values, for {GIVE_UP / 60.0:g} min"
                )
        if undone or problems:
            raise BackendError("; ".join([*undone, *problems]))

    @staticmethod
    def _let_go_of_guard(guard: GuardLink, problems: Collection[str]) -> None:
        # A node that does not answer now may do so later, with the values of a trial.
        if problems:
            guard.hand_over()
        else:
            guard.end()

    def _restore(self, previous: PreviousParameters, problems: list[str]) -> None:
        if self._client is not None:
            approach = self._client.approach.as_far_as_possible
            problems += previous.restore(self._restore_timeout, approach)
            problems += self._client.start_values.reconfigure_restored()

    def _park_last(self, at_once: bool) -> list[str]:
        # One that the tuner has started ends next, and need not start once more for that.
        return self._opened.safe_state.park(start_anew=self._attach, at_once=at_once)

    def _leave(self, tuner: TunerNode, procedure: Procedure, undone: list[str]) -> None:
        if self._attach:
            undone += procedure.leave()
        else:
            # A node that the tuner has started ends with it.
            self._warn_of(tuner, procedure.leave)

    @staticmethod
    def _warn_of(tuner: TunerNode, act: Callable[[], list[str]]) -> None:
        for problem in act():
            tuner.warn(problem)

    def _let_go(self) -> None:
        self._claim = self._tuner = self._client = self._procedure = self._previous = None
        self._while_open = self._on_nodes = self._guard = None

    @property
    def _restore_timeout(self) -> float:
        """Time [s] that a node has to answer in the end: an interrupted evaluation may go on."""
        trigger = self._study.trigger
        return PARK_TIMEOUT if trigger is None else max(PARK_TIMEOUT, trigger.timeout)

    def _watch(self) -> None:
        self._look()
        if self._guard is not None:
            self._guard.look(at_rest=self._while_open is None)
        self._started.check()

    def _is_interrupted(self) -> bool:
        try:
            self._interrupted()
        except Interrupted:
            return True
        return False

    def _look(self) -> None:
        """Check for an interruption and a suspension, not the nodes."""
        self._suspension.look()
        self._interrupted()
