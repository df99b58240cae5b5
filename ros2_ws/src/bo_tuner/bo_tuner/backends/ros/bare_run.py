"""One run on a study's nodes, without what the machine needs around it."""

from collections.abc import Collection, Mapping
from functools import partial

from bo_tuner.backends.ros.errors import (
    DiedError,
    DisturbedError,
    LostError,
    RefusedError,
    UnpreparedError,
)
from bo_tuner.backends.ros.guard.link import GuardActedError
from bo_tuner.backends.ros.guarded import Guarded
from bo_tuner.backends.ros.opened import Opened
from bo_tuner.backends.ros.parameters.events import Values
from bo_tuner.backends.ros.procedure import Procedure
from bo_tuner.backends.ros.safe_state import parks_after_runs
from bo_tuner.metrics.collect import Collector, cut_short
from bo_tuner.metrics.message_rates import MessageRates
from bo_tuner.metrics.recording import (
    NOTHING_RECORDED,
    CutShortError,
    FailedRunError,
    GapError,
    NotFiniteError,
    Recording,
)
from bo_tuner.run_notes import Death, Notes, Unusable
from bo_tuner.study.nodes import FAILURE
from bo_tuner.text import brief
from bo_tuner.trials import Evaluation, EvaluationState, Outcome

ENDING = 1.0
"""Time [s] that a process takes to end once nothing is heard of it any more."""

FAULTS = (
    CutShortError,
    RefusedError,
    FailedRunError,
    DisturbedError,
    UnpreparedError,
    LostError,
)
"""What ends a run, and is its outcome."""


class BareRun:
    """Runs on the nodes, one after the other.

    All parameters of the nodes that the study does not set are held at the values that the nodes
    had when the backend was opened. An evaluation during which any parameter had another value than
    it should is a failed one.
    """

    def __init__(
        self, opened: Opened, guarded: Guarded, collector: Collector, rates: MessageRates
    ) -> None:
        self._opened = opened
        self._study = opened.study
        self._client = opened.client
        self._procedure = opened.procedure
        self._guarded = guarded
        self._collector = collector
        self._rates = rates
        self._parks_after_run = parks_after_runs(opened.study)

    def rest(self) -> tuple[float, Outcome | None]:
        """Let the machine rest ahead of each run; see `layers.rest`."""
        procedure = self._procedure
        try:
            self._guarded.heed()
            if procedure is None:
                return 0.0, None
            procedure.forget()
            procedure.expect_rest()
            return procedure.rest(), None
        except FailedRunError as error:
            return 0.0, self._fault(UnpreparedError(str(error)))
        except FAULTS as fault:
            return 0.0, self._fault(fault)

    def run(self, planned: Evaluation) -> Outcome:
        """Set parameters, run one evaluation, and collect its metrics."""
        held = self._opened.held
        assignments = self._study.assignments(planned.parameters, planned.context, planned.seed)
        wanted = {key: {**held[key], **assignments.get(key, {})} for key in held}
        kept = {key: held[key].keys() - assignments.get(key, {}) for key in held}
        try:
            self._get_ready(planned, wanted)
        except FAULTS as fault:
            return self._fault(fault)
        try:
            return self._performed(planned, wanted, kept)
        except FAULTS as fault:
            return self._fault(fault, in_force=planned)

    def _get_ready(self, planned: Evaluation, wanted: Values) -> None:
        if self._opened.previous is not None:
            self._opened.previous.announce(wanted)
        if self._procedure is not None:
            self._procedure.enter(planned.parameters, planned.context, planned.beyond)
            if self._study.park.between_runs:
                self._prepare(self._procedure)
        # One that has ended before did not do so with these values.
        self._opened.started.check()

    def _performed(
        self, planned: Evaluation, wanted: Values, kept: Mapping[str, Collection[str]]
    ) -> Outcome:
        client, suspension = self._client, self._opened.suspension
        run = None if self._procedure is None else partial(self._perform, self._procedure)
        client.start_values.fill({**planned.parameters, **planned.context})
        said = client.evaluate(wanted, kept, run, self._park_after_run)
        suspension.look()
        result = self._collector.outcome(said, wanted)
        # A metric may be a function of the user's that takes its time.
        suspension.skip()
        return self._counted(result).noted(
            ignored_results=client.results.take_ignored(),
            rates=self._rates.of(self.recording),
            remark=brief("; ".join(self._rates.remarks(self.recording))),
            held={f"{key}.{name}": value for key, name, value in client.rounded},
        )

    def _fault(self, error: Exception, in_force: Evaluation | None = None) -> Outcome:
        """Return what an evaluation is that was ended by this; `in_force` if its values were."""
        failed, reason = EvaluationState.FAILED, brief(str(error))
        match error:
            case CutShortError():
                beyond = {} if in_force is None else in_force.beyond
                return self._counted(cut_short(self._study, beyond, error.seconds, error.so_far))
            case RefusedError() | FailedRunError():
                gap = error.seconds if isinstance(error, GapError) else None
                return self._counted(Outcome(failed, {}, reason, notes=Notes(gap=gap)))
            case DisturbedError():
                disturbed = Notes(unusable=Unusable.DISTURBED)
                return self._counted(Outcome(failed, {}, reason, notes=disturbed))
            case GuardActedError():
                return self._guarded.overruled(error)
            case UnpreparedError():
                return Outcome(failed, {}, reason, notes=Notes(unusable=Unusable.UNPREPARED))
        loss = self._death_behind(error)
        notes = Notes(death=None if in_force is None else self._death(loss))
        return Outcome(EvaluationState.LOST, {}, brief(str(loss)), notes=notes)

    def _death_behind(self, loss: Exception) -> Exception:
        """Return that a node has died, if that is why it is lost: its topics may go ahead of it."""
        started, tuner = self._opened.started, self._opened.tuner
        if isinstance(loss, DiedError) or not started.processes:
            return loss
        try:
            with tuner.watched_by(self._opened.look):
                tuner.wait_until(lambda: started.has_ended, ENDING)
            started.check()
        except DiedError as death:
            return death
        return loss

    def _death(self, loss: Exception) -> Death | None:
        """Return which node has died with the values of an evaluation in force."""
        if not isinstance(loss, DiedError):
            return None
        return Death(loss.key, anyway=self._study.nodes[loss.key].death != FAILURE)

    def _counted(self, outcome: Outcome) -> Outcome:
        """Return an outcome with the messages of the run."""
        if self._procedure is None:
            return outcome
        return outcome.noted(
            signals=self.recording.counts(),
            streams=self._procedure.published(),
            played=self._procedure.played(),
        )

    @property
    def recording(self) -> Recording:
        """What was recorded of the last run."""
        return NOTHING_RECORDED if self._procedure is None else self._procedure.recording

    def _prepare(self, procedure: Procedure) -> None:
        """Prepare a run with the safe parameters."""
        # A node that has ended is reported as ended, not as one that does not answer.
        self._opened.started.check()
        if problems := self._opened.safe_state.park():
            raise LostError("; ".join(problems))
        try:
            procedure.prepare()
        except (RefusedError, FailedRunError, DisturbedError) as error:
            self._stop_failed(procedure, error)
            reason = f"the preparation with the safe parameters failed: {error}"
            raise UnpreparedError(reason) from error

    def _perform(self, procedure: Procedure) -> None:
        try:
            if not self._study.park.between_runs:
                procedure.prepare()
            procedure.perform(self._rates.largest_gaps)
        except (FailedRunError, DisturbedError) as error:
            self._stop_failed(procedure, error)
            raise

    def _stop_failed(self, procedure: Procedure, error: Exception) -> None:
        """Stop the machine in a run that failed, and raise if the parameters were not the cause."""
        client, safe_state = self._client, self._opened.safe_state
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
