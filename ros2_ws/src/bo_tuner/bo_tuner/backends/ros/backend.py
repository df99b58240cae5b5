"""Evaluations on ROS 2 nodes, which the backend starts, watches, and restarts when one is lost."""

import contextlib
import dataclasses
import os
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from rclpy.context import Context

from bo_tuner.backends.protocol import SequentialBackend
from bo_tuner.backends.ros.bringup import Bringup
from bo_tuner.backends.ros.clock import TOPIC as CLOCK
from bo_tuner.backends.ros.clock import check_wall_clock
from bo_tuner.backends.ros.errors import (
    DiedError,
    DisturbedError,
    LostError,
    RefusedError,
    UnpreparedError,
)
from bo_tuner.backends.ros.guard.link import LEASE, GuardActedError, GuardLink, GuardSilentError
from bo_tuner.backends.ros.guard.plan import GIVE_UP, Plan
from bo_tuner.backends.ros.isolation import (
    DomainClaim,
    domain_of_environment,
    isolated_environment,
    namespace_of,
)
from bo_tuner.backends.ros.others import START
from bo_tuner.backends.ros.parameters.at_rest import take_over
from bo_tuner.backends.ros.parameters.events import Values
from bo_tuner.backends.ros.parameters.previous import PreviousParameters
from bo_tuner.backends.ros.procedure import Procedure
from bo_tuner.backends.ros.safe_state import PARK_TIMEOUT, SafeState, parks_after_runs
from bo_tuner.backends.ros.started_nodes import StartedNodes
from bo_tuner.backends.ros.study_client import StudyClient
from bo_tuner.backends.ros.suspension import Suspension
from bo_tuner.backends.ros.tuner_node import CALL_TIMEOUT, SPIN_PERIOD, TunerNode
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.interruption import Interrupted
from bo_tuner.metrics.collect import Collector, cut_short
from bo_tuner.metrics.latest_messages import LatestMessage
from bo_tuner.metrics.message_rates import MessageRates
from bo_tuner.metrics.recording import (
    NOTHING_RECORDED,
    CutShortError,
    FailedRunError,
    GapError,
    NotFiniteError,
    Recording,
)
from bo_tuner.metrics.signal_sources import signal_sources
from bo_tuner.numerics.seeds import Stream, noise_seed
from bo_tuner.processor_load import busy_in_words, explains, with_children
from bo_tuner.run_notes import Death, Notes, Unusable
from bo_tuner.study.configuring import stays_in_force
from bo_tuner.study.nodes import FAILURE
from bo_tuner.study.parts import ROS
from bo_tuner.study.run import SIM
from bo_tuner.study.safe_values import safe_values
from bo_tuner.study.step_values import left_by_calls
from bo_tuner.study.study import Study
from bo_tuner.text import brief
from bo_tuner.trials import (
    Evaluation,
    EvaluationState,
    Outcome,
    Stage,
)

ATTEMPTS = 3
"""Times that an evaluation is run during which the tuner is suspended, until it counts as lost."""

ENDING = 1.0
"""Time [s] that a process takes to end once nothing is heard of it any more."""
AGAIN = 0.5
"""Time [s] between two attempts to leave the machine safe while its guard is silent."""

AtAbort = Callable[[Evaluation, Outcome, Sequence[LatestMessage]], object]
"""Takes an evaluation whose run was aborted, its outcome, and the messages until then."""


class _Opened(NamedTuple):
    """What an open backend has."""

    tuner: TunerNode
    client: StudyClient
    bringup: Bringup
    safe_state: SafeState


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
        super().__init__(study)
        self._study = study
        self._collector = Collector(study)
        self._rates = MessageRates(study)
        self._functions = contextlib.ExitStack()
        self._parks_after_run = parks_after_runs(study)
        self._rested = 0.0
        self._latest_run: float | None = None
        self._log_directory = log_directory
        self._attach = attach
        self._restored = study if keep_parked else study.without_safe_parameters()
        self._run_log = run_log
        self._guarded = guard
        self._halt = halt
        self._guard: GuardLink | None = None
        self._taken_over = False
        self._ros_arguments = ros_arguments or []
        self._namespace = namespace_of(self._ros_arguments)
        self._interrupted = interrupted
        self.at_nodes: Callable[[TunerNode], None] = lambda tuner: None
        self.at_abort: AtAbort = lambda planned, outcome, latest: None
        self._claim: DomainClaim | None = None
        self._tuner: TunerNode | None = None
        self._client: StudyClient | None = None
        self._procedure: Procedure | None = None
        self._environment: dict[str, str | None] = {}
        self._bringup: Bringup | None = None
        self._held: Values = {}
        self._suspension = Suspension()
        self._gap: float | None = None
        self._safe_state: SafeState | None = None
        self._previous: PreviousParameters | None = None
        self._started = StartedNodes(study, self._namespace, log_directory, worker)

    def open(self) -> None:
        """Start the nodes, unless attached, and wait until they are discovered."""
        check_wall_clock()
        sources = signal_sources(self._study, lambda: self.recording, lambda: self._interrupted())
        self._collector = Collector(self._study, self._functions.enter_context(sources))
        given = domain_of_environment()
        tuner, client = self._enter(given)
        self._bringup = Bringup(
            self._study, tuner, client, self._started, self._suspension, attach=self._attach
        )
        try:
            if self._guarded:
                plan = Plan.of(self._study, attached=self._attach)
                self._guard = GuardLink(tuner, plan, self._log_directory, attached=self._attach)
            self._bringup.open(safe_values(self._study), look_around=given is not None)
            if self._guard is not None:
                self._guard.begin(self._study, self._ros_arguments)
            self.at_nodes(tuner)
            if self._attach:
                self._previous = PreviousParameters(self._restored, tuner, client.parameters)
                client.approach.announce = self._previous.announce
            safe, self._held = take_over(
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
                restart = None if self._attach else self._bringup.restart
                self._procedure = Procedure(
                    self._study, run, tuner, client.parameters, restart, self._guard
                )
                client.start_values.between = self._procedure.forget_ended
                client.start_values.after = self._procedure.welcome
            self._safe_state = SafeState(
                self._study,
                tuner,
                client,
                safe,
                self._held,
                self._procedure,
                self._suspension,
                self._look,
            )
        except LostError as loss:
            hint = f" (--attach starts no node: {START})" if self._attach else ""
            raise BackendError(f"{loss}{hint}") from loss

    def _enter(self, domain: int | None) -> tuple[TunerNode, StudyClient]:
        """Claim a ROS domain, by number or any, and join it."""
        # Without a domain in the environment, nodes that run already are in 0.
        self._claim = DomainClaim(self._namespace, 0 if self._attach and domain is None else domain)
        if not self._attach:
            # The middleware reads the environment of the process, in this one too.
            self._set_environment(isolated_environment(self._claim.domain))
        os.environ.setdefault("ROS_LOG_DIR", str(self._log_directory))
        self._tuner = TunerNode(self._claim.domain, self._ros_arguments, self._watch)
        started = None if self._attach else self._started
        self._client = StudyClient(self._study, self._tuner, started)
        return self._tuner, self._client

    def _set_environment(self, variables: Mapping[str, str]) -> None:
        self._environment = {name: os.environ.get(name) for name in variables}
        os.environ.update(variables)

    def _reset_environment(self) -> None:
        """Restore the domain, so that a later backend does not take this one for the user's."""
        for name, value in self._environment.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        self._environment = {}

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

    def run(self, evaluations: Iterable[Evaluation]) -> Iterator[Evaluation]:
        """Run planned evaluations in the order given; runs that warm the machine up come ahead."""
        for planned in evaluations:
            count, begin = self._runs_to_warm_up, time.monotonic()
            fault = self._warm_up(count)
            seconds = time.monotonic() - begin
            if fault is not None:
                yield dataclasses.replace(planned, outcome=fault, seconds=seconds)
                continue
            for evaluation in super().run([planned]):
                warmed = {"warm_ups": count, "warm_up_seconds": round(seconds, 3)} if count else {}
                outcome = evaluation.outcome.noted(**warmed)
                yield dataclasses.replace(evaluation, outcome=outcome)

    @property
    def _runs_to_warm_up(self) -> int:
        """How many runs the machine needs to be warm."""
        warm_up = None if self._study.run is None else self._study.run.warm_up
        if warm_up is None:
            return 0
        latest = self._latest_run
        is_warm = latest is not None and time.monotonic() - latest <= warm_up.after
        return 0 if is_warm else warm_up.runs

    def _warm_up(self, count: int) -> Outcome | None:
        """Make so many runs that count nothing; returns what an evaluation is without one of them.

        They have the parameters that the search begins with, as the most trusted ones. Where a run
        with these fails, nothing is known of those of an evaluation, which is not made then.
        """
        study, contexts = self._study, self._study.context_space()
        parameters = next(iter(study.starting_sets()), study.search_space().defaults)
        nominal = contexts.to_dict(contexts.nominal())
        for k in range(count):
            seed = noise_seed(study.seed, Stream.NOISE, 0, k)
            outcome = self.outcome(Evaluation(0, k, Stage.NOMINAL, parameters, nominal, seed))
            self.after_extra_run()
            if outcome.complete:
                continue
            self._latest_run = None
            reason = brief(f"run {k + 1} of {count} to warm up: {outcome.reason}")
            unusable = outcome.notes.unusable if outcome.unusable else Unusable.UNPREPARED
            fault = dataclasses.replace(outcome, reason=reason)
            return fault.noted(unusable=unusable, death=None)
        return None

    def outcome(self, planned: Evaluation) -> Outcome:
        """Set parameters, run one evaluation, and collect its metrics.

        All parameters of the nodes that the study does not set are held at the values that the
        nodes had when the backend was opened. An evaluation during which any parameter had another
        value than it should is a failed one. After a lost evaluation the nodes are started anew,
        or, attached, waited for. One during which this process was suspended says nothing of the
        parameters, and is repeated.
        """
        for _ in range(ATTEMPTS):
            # A request to end that came during the proposal, or while the tuner was suspended: no
            # node is to get these parameters.
            self._look()
            self._suspension.begin()
            self._taken_over = False
            self._gap = None
            outcome = self._with_starts(self._attempt(planned))
            self._suspension.look()
            seconds = self._suspension.seconds
            # What the guard has ended is not repeated until somebody has looked at the machine.
            if not seconds or self._taken_over:
                self._rates.note(outcome)
                return outcome
        return Outcome(EvaluationState.LOST, {}, f"the tuner was suspended for {seconds:.0f} s")

    def weighed(self, outcome: Outcome, seconds: float) -> Outcome:
        """Return an outcome; a gap that may be the computer's is not the parameters' failure."""
        failed = outcome.state is EvaluationState.FAILED
        if self._gap is None or not failed or not explains(outcome.load, self._gap, seconds):
            return outcome
        reason = brief(f"{outcome.reason}; {busy_in_words(outcome.load)}")
        return dataclasses.replace(outcome, reason=reason).noted(unusable=Unusable.DISTURBED)

    def start_anew(self) -> None:
        """Have nodes that take values only at their start begin the next evaluation with one."""
        self._opened.client.start_values.forget_all()

    def _with_starts(self, outcome: Outcome) -> Outcome:
        """Return an outcome with how long it took to start nodes anew with its values."""
        starts = [] if self._client is None else self._client.start_values.take_starts()
        return outcome.with_starts(len(starts), sum(starts))

    def _attempt(self, planned: Evaluation) -> Outcome:
        safe_state = self._opened.safe_state
        safe_state.take_unfinished()
        try:
            outcome = self._watched_over(self._evaluated(planned))
        except BaseException as error:
            # Such as a signal. Records are closed before this backend is, and may take their time.
            for problem in [*safe_state.stop(), *safe_state.take_unfinished()]:
                self._opened.tuner.warn(problem)
            self._tell_of_abort(planned, Outcome(EvaluationState.LOST, {}, brief(str(error))))
            raise
        self._latest_run = time.monotonic()
        self._tell_of_abort(planned, outcome)
        try:
            problems = self._leave_safe(outcome.state)
        except Interrupted:
            # The run ends, but not without what is known of these parameters.
            problems = safe_state.stop()
        problems = [*safe_state.take_unfinished(), *problems]
        if not problems:
            return outcome
        # What was tried more than once is reported once.
        text = brief("; ".join(dict.fromkeys(problems)))
        if outcome.state is EvaluationState.COMPLETE:
            # The outcome of a complete run does not say what went wrong after it.
            self._opened.tuner.warn(text)
            return outcome.noted(park_problem=text)
        said = [problem for problem in problems if problem not in outcome.reason]
        reason = brief("; ".join(dict.fromkeys([outcome.reason, *said])))
        return dataclasses.replace(outcome, reason=reason)

    def _tell_of_abort(self, planned: Evaluation, outcome: Outcome) -> None:
        if self._procedure is not None and self._procedure.before_abort:
            self.at_abort(planned, outcome, self._procedure.before_abort)

    def _watched_over(self, outcome: Outcome) -> Outcome:
        """Return an outcome, or that it was lost since the guard has acted meanwhile.

        What the guard sets and publishes would else be taken for somebody else's doing.
        """
        try:
            # The guard publishes ten states a second, but has set the nodes already.
            self._await_guard(0.0 if outcome.state is EvaluationState.COMPLETE else SPIN_PERIOD)
        except GuardActedError as acted:
            return self._overruled(acted)
        return outcome

    def _overruled(self, acted: GuardActedError) -> Outcome:
        """Return the outcome of an evaluation in which the guard has acted."""
        if self._guard is not None:
            self._guard.unheeded = None
        aborted = "" if self._procedure is None else self._procedure.reason_of_abort
        if acted.on_condition and aborted and not acted.ends:
            # It was quicker than this process, which would have done the same.
            return Outcome(EvaluationState.FAILED, {}, brief(f"{aborted}; {acted}"))
        if acted.takes_over:
            self._taken_over = True
            if self._halt is None or acted.ends:
                raise BackendError(str(acted)) from acted
            self._halt(str(acted))
        return Outcome(EvaluationState.LOST, {}, brief(str(acted)))

    def _evaluated(self, planned: Evaluation) -> Outcome:
        """Run an evaluation; whatever becomes of it is an outcome."""
        client = self._opened.client
        client.approach.take_seconds()
        assignments = self._study.assignments(planned.parameters, planned.context, planned.seed)
        wanted = {key: {**held, **assignments.get(key, {})} for key, held in self._held.items()}
        kept = {key: held.keys() - assignments.get(key, {}) for key, held in self._held.items()}
        in_force = False
        try:
            self._await_guard()
            if self._guard is not None and self._guard.unheeded is not None:
                # It has acted after the last evaluation, such as while a node was waited for.
                raise self._guard.unheeded
            if self._previous is not None:
                self._previous.announce(wanted)
            run = None
            if self._procedure is not None:
                self._procedure.forget()
                self._procedure.expect_rest()
                self._rest(self._procedure)
                self._procedure.enter(planned.parameters, planned.context, planned.beyond)
                if self._study.park.between_runs:
                    self._prepare(self._procedure)
                run = partial(self._run, self._procedure)
            # One that has ended before did not do so with these values.
            self._started.check()
            in_force = True
            client.start_values.fill({**planned.parameters, **planned.context})
            said = client.evaluate(wanted, kept, run, self._park_after_run)
            self._suspension.look()
            result = self._collector.outcome(said, wanted)
            # A metric may be a function of the user's that takes its time.
            self._suspension.skip()
        except CutShortError as end:
            ended = cut_short(self._study, planned.beyond, end.seconds, end.so_far)
            return self._counted(ended)
        except (RefusedError, FailedRunError) as refusal:
            self._gap = refusal.seconds if isinstance(refusal, GapError) else None
            return self._counted(Outcome(EvaluationState.FAILED, {}, brief(str(refusal))))
        except DisturbedError as error:
            disturbed = Notes(unusable=Unusable.DISTURBED)
            return self._counted(
                Outcome(EvaluationState.FAILED, {}, brief(str(error)), notes=disturbed)
            )
        except GuardActedError as acted:
            return self._overruled(acted)
        except UnpreparedError as error:
            unprepared = Notes(unusable=Unusable.UNPREPARED)
            return Outcome(EvaluationState.FAILED, {}, brief(str(error)), notes=unprepared)
        except LostError as loss:
            loss = self._death_behind(loss)
            notes = Notes(death=self._death(loss) if in_force else None)
            return Outcome(EvaluationState.LOST, {}, brief(str(loss)), notes=notes)
        return self._counted(result).noted(
            ignored_results=client.results.take_ignored(),
            rates=self._rates.of(self.recording),
            remark=brief("; ".join(self._rates.remarks(self.recording))),
            held={f"{key}.{name}": value for key, name, value in client.rounded},
        )

    def _death_behind(self, loss: LostError) -> LostError:
        """Return that a node has died, if that is why it is lost: its topics may go ahead of it."""
        if isinstance(loss, DiedError) or not self._started.processes:
            return loss
        try:
            with self._opened.tuner.watched_by(self._look):
                self._opened.tuner.wait_until(lambda: self._started.has_ended, ENDING)
            self._started.check()
        except DiedError as death:
            return death
        return loss

    def _death(self, loss: LostError) -> Death | None:
        """Return which node has died with the values of an evaluation in force."""
        if not isinstance(loss, DiedError):
            return None
        return Death(loss.key, anyway=self._study.nodes[loss.key].death != FAILURE)

    def _counted(self, outcome: Outcome) -> Outcome:
        """Return an outcome with the times that the machine took, and the messages of the run."""
        outcome = outcome.noted(
            rested_seconds=round(self._rested, 3),
            ramped_seconds=round(self._opened.client.approach.take_seconds(), 3),
        )
        if self._procedure is None:
            return outcome
        return outcome.noted(
            signals=self._procedure.recording.counts(),
            streams=self._procedure.published(),
            played=self._procedure.played(),
        )

    def _rest(self, procedure: Procedure) -> None:
        """Let the machine rest ahead of a run."""
        self._rested = 0.0
        try:
            self._rested = procedure.rest()
        except FailedRunError as error:
            raise UnpreparedError(str(error)) from error

    def _prepare(self, procedure: Procedure) -> None:
        """Prepare a run with the safe parameters."""
        # A node that has ended is reported as ended, not as one that does not answer.
        self._started.check()
        if problems := self.park():
            raise LostError("; ".join(problems))
        try:
            procedure.prepare()
        except (RefusedError, FailedRunError, DisturbedError) as error:
            self._stop_failed(procedure, error)
            reason = f"the preparation with the safe parameters failed: {error}"
            raise UnpreparedError(reason) from error

    def _run(self, procedure: Procedure) -> None:
        try:
            if not self._study.park.between_runs:
                procedure.prepare()
            procedure.perform(self._rates.largest_gaps)
        except (FailedRunError, DisturbedError) as error:
            self._stop_failed(procedure, error)
            raise

    def _stop_failed(self, procedure: Procedure, error: Exception) -> None:
        """Stop the machine in a run that failed, and raise if the parameters were not the cause."""
        client, safe_state = self._opened.client, self._opened.safe_state
        # Parking overlooks what others have changed.
        disturbance = client.parameters.disturbance()
        unpublished = procedure.unpublished
        # First the machine, then the reason: a node that does not answer is waited for.
        safe_state.stop()
        if disturbance is not None:
            raise disturbance from error
        if isinstance(error, DisturbedError):
            raise error
        # A run may have failed for want of a node; one that has died of values that are not finite
        # has not taken the reason along.
        try:
            for key in self._study.nodes:
                client.parameters.expect_answer(key)
        except DiedError:
            if not isinstance(error, NotFiniteError):
                raise
            return
        if gone := unpublished or procedure.unpublished:
            raise LostError(gone)

    def _park_after_run(self) -> None:
        if self._parks_after_run:
            self._opened.safe_state.park_after_run()

    def _leave_safe(self, state: EvaluationState) -> list[str]:
        """Leave the nodes as they are to be after an evaluation; returns what went wrong."""
        safe_state = self._opened.safe_state
        if state is EvaluationState.COMPLETE:
            # What was not parked right after a run is not watched until the next one.
            return safe_state.take_unfinished() and safe_state.park(at_once=True)
        if state is EvaluationState.LOST or self._started.has_ended:
            # Of the node that was lost nothing else is to be expected than that it is not parked.
            if (problems := safe_state.stop()) and self._attach:
                self._expect_to_be_known(problems)
            try:
                self._opened.bringup.get_back()
            except (LostError, BackendError, StudyError) as error:
                # The next evaluation will be lost in turn; three lost trials end the run.
                return [f"not recovered: {error}"]
        return safe_state.recover()

    def _expect_to_be_known(self, problems: list[str]) -> None:
        """Refuse to go on if this process was stopped, and nodes do not answer it since then.

        ROS takes a process that is silent for long for dead. One that lives again is discovered
        anew, but its services may never be answered again (Fast DDS 2.14).
        """
        self._suspension.look()
        # A shorter gap is that of a busy computer, unless the guard has found it too long.
        seconds = self._suspension.longest if self._taken_over else self._suspension.seconds
        if seconds > LEASE:
            raise BackendError(
                f"this process was stopped for {seconds:.0f} s, and ROS took it for dead: "
                f"{'; '.join(problems)}; look at the machine, then resume the run"
            )

    @property
    def _opened(self) -> _Opened:
        tuner, client = self._tuner, self._client
        bringup, safe_state = self._bringup, self._safe_state
        if tuner is None or client is None or bringup is None or safe_state is None:
            raise BackendError("the backend is not open")
        return _Opened(tuner, client, bringup, safe_state)

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
            stack.callback(self._functions.close)
            stack.callback(self._reset_environment)
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
            if self._guarded:
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
        self._bringup = self._safe_state = self._guard = None

    @property
    def _restore_timeout(self) -> float:
        """Time [s] that a node has to answer in the end: an interrupted evaluation may go on."""
        trigger = self._study.trigger
        return PARK_TIMEOUT if trigger is None else max(PARK_TIMEOUT, trigger.timeout)

    def _watch(self) -> None:
        self._look()
        self._look_at_guard()
        self._started.check()

    def _look_at_guard(self) -> None:
        if self._guard is not None:
            self._guard.look(at_rest=self._safe_state is None)

    def _await_guard(self, period: float = 0.0) -> None:
        """See for a period [s] what the guard does; if it is silent, wait with the machine safe.

        It is left safe first, and again as long as ROS does not carry that.
        """
        guard, tuner = self._guard, self._opened.tuner
        if guard is None:
            return

        def look() -> None:
            self._look()
            self._look_at_guard()

        # A node that has ended keeps nobody from seeing to the machine.
        with tuner.watched_by(look):
            with contextlib.suppress(GuardSilentError):
                self._look_at_guard()
                if not guard.is_silent:
                    tuner.spin_for(period)
            if not guard.is_silent:
                return
            problems = self._opened.safe_state.stop()
            while not tuner.wait_until(lambda: not guard.is_silent, AGAIN):
                problems = problems and self._opened.safe_state.stop()

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
