"""Ask and tell: a run whose evaluations somebody else carries out; the journal is its state."""

import contextlib
import json
import threading
import time
from collections.abc import Generator, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Self

from threadpoolctl import ThreadpoolController

from bo_tuner.api.earlier import ADDED, EarlierRun, added_trial
from bo_tuner.api.result import Result, load
from bo_tuner.api.run import OpenRun
from bo_tuner.backends.function import Returned, failed
from bo_tuner.backends.layers.beside_default import DefaultBeside
from bo_tuner.backends.protocol import Backend, opened_backend
from bo_tuner.codec import checks
from bo_tuner.codec.reading import JSON, read
from bo_tuner.codec.writing import to_json
from bo_tuner.errors import (
    ConditionError,
    ParameterError,
    RunError,
    RunRecordError,
    StudyError,
    UnknownRunError,
    WindowFull,
)
from bo_tuner.methods.registry import METHODS, method_of, problem_of
from bo_tuner.plans import Event, EventKind, Phase, Phases, Plan, Withdrawal
from bo_tuner.storage.record import RunRecord, read_run
from bo_tuner.study.changes import changes, summarized
from bo_tuner.study.ending_early import check_ends_early
from bo_tuner.study.function_study import FUNCTION
from bo_tuner.study.study import Study
from bo_tuner.text import brief
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage, Value, parameter_set
from bo_tuner.tuning.driver import Steps
from bo_tuner.tuning.loop import TrialPlan
from bo_tuner.tuning.observer import NOBODY, RunObserver
from bo_tuner.tuning.summary import Conclusion, concluding

LARGEST_WINDOW = 1000


@dataclass(frozen=True)
class Run:
    """A run to carry out: one evaluation.

    Attributes
    ----------
    trial, index
        Number of the trial, and of the run within it, from 0. In the validation the default has
        the number 0 and the result 1.
    stage
        Its purpose, such as ``drawn`` or ``validation``.
    parameters
        Value of every parameter, by name.
    context
        Value of every context variable, by name.
    seed
        Seed of its noise.
    evaluation
        The same as the rest of the program has it; not part of the interface.
    """

    trial: int
    index: int
    stage: str
    parameters: dict[str, Value]
    context: dict[str, Value]
    seed: int
    evaluation: Evaluation = field(repr=False, compare=False)

    def __hash__(self) -> int:
        return hash((self.stage, self.trial, self.index, self.seed))

    @classmethod
    def of(cls, evaluation: Evaluation, study: Study) -> Self:
        """Make it of a planned evaluation."""
        return cls(
            evaluation.trial,
            evaluation.index,
            str(evaluation.stage),
            study.as_given(evaluation.parameters),
            dict(evaluation.context),
            evaluation.seed,
            evaluation,
        )


@dataclass(frozen=True)
class _Part:
    """Some metrics of a run that is waited for, and what else was told of it."""

    metrics: Mapping[str, float]
    errors: Mapping[str, float] = field(default_factory=dict)
    as_set: Mapping[str, Value] = field(default_factory=dict)


@dataclass(frozen=True)
class _PartOfRun:
    """A part as the journal has it: the key of its run, and what was told; None: forget all."""

    run: str
    told: _Part | None


@dataclass
class _Pending:
    """A planned evaluation that was asked for, and which of its runs is due."""

    planned: Evaluation
    runs: Generator[Evaluation, Outcome, Outcome]
    due: Evaluation
    asked_for: bool = False
    parts: list[_Part] = field(default_factory=list)
    begin: float = field(default_factory=time.monotonic)


class Tuner:
    """A run that asks for its evaluations; made by `Study.tuner`.

    What it asks for follows from the study, the window and the results alone, not from the order in
    which these are told. Each result is on disk when the call returns. A process that dies goes on
    in a new tuner with the same folder: it asks again for what was not told.

    Threads that ask and tell at once wait for each other. Use it in a ``with`` block, or `close`
    it.
    """

    def __init__(self, run: OpenRun) -> None:
        self._run = run
        self._returned = Returned(run.study)
        self._beside = DefaultBeside(run.study)
        self._threads = ThreadpoolController()
        self._one_thread = threading.RLock()
        self._pending: dict[tuple[object, ...], _Pending] = {}
        self._plan: Plan[Any] | None = None
        self._steps: Steps[Any] | None = None
        self._over = False
        self._parts: dict[str, list[_Part]] = {}
        for event in run.events:
            if event.kind is EventKind.PART:
                part = read(_PartOfRun, json.loads(event.detail), JSON)
                known = self._parts.setdefault(part.run, [])
                known[:] = [] if part.told is None else [*known, part.told]
        with self._working():
            self._phases = self._all_phases()
            self._next_phase()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def folder(self) -> Path:
        """Folder of the run."""
        return self._run.path

    def ask(self) -> Run | None:
        """Return the next run to carry out; None when all is done and the result is there.

        Raises
        ------
        WindowFull
            If nothing more can be planned before the result of a run is told.
        RunError
            If the tuner is closed.
        """
        with self._one_thread:
            if self._over:
                return None
            with self._working():
                run = self._next_run()
            if run is None and not self._over:
                count, window = len(self._pending), self._run.window
                raise WindowFull(f"tell a result first: {count} of {window} are waited for")
            return run

    def tell(
        self,
        run: Run,
        metrics: Mapping[str, float],
        *,
        parameters: Mapping[str, Value] | None = None,
        errors: Mapping[str, float] | None = None,
        more: bool = False,
    ) -> None:
        """Take the result of a run.

        Parameters
        ----------
        run
            As it was asked for.
        metrics
            A number for each metric that is not computed from others. One that is not finite is a
            failed run.
        parameters
            Values that were really set, where they are not those that were asked for; the models
            take these.
        errors
            Known standard errors of the metrics, by name, each in its unit: what the same run would
            scatter by. The models take them in place of the noise that they find.
        more
            Whether other metrics come later, by a further call.

        Raises
        ------
        UnknownRunError
            If nobody waits for it: it was told already, or is of another tuner.
        MetricsError
            If these are no numbers for the metrics; the run is still waited for.
        StudyError
            If the study does not permit the parameters that were set, or the models of the
            algorithm know of no such values or errors.
        RunError
            If the tuner is closed.
        """
        pending = self._awaited(run)
        errors, as_set = self._errors(errors), self._as_set(run, parameters)
        if more:
            told = _Part(self._returned.part(metrics), errors, as_set)
            with self._one_thread, self._working():
                pending.parts.append(told)
                self._note_event(EventKind.PART, _PartOfRun(_text(pending.due), told))
            return
        parts = pending.parts
        if parts and isinstance(metrics, Mapping):
            metrics = _joined([*(part.metrics for part in parts), metrics])
        errors = _joined([*(part.errors for part in parts), errors])
        as_set = _joined([*(part.as_set for part in parts), as_set])
        self.tell_outcome(run, self._returned.outcome(metrics, errors).noted(as_set=as_set))

    def add(
        self,
        parameters: Mapping[str, Value],
        context: Mapping[str, Value],
        metrics: Mapping[str, float],
        errors: Mapping[str, float] | None = None,
        *,
        failure: str = "",
    ) -> None:
        """Take a run that was not asked for, such as one that somebody has made by hand.

        It becomes a trial of its own, which counts in the budget, and informs all that is proposed
        from now on; a run that was asked for already is still waited for. Its context counts as one
        of a search, since nobody knows how it was chosen.

        Parameters
        ----------
        parameters
            Its values by name; what is left out had the default.
        context
            In which it was, by name; what is left out was nominal.
        metrics
            As in `tell`; empty for a run that failed.
        errors
            As in `tell`.
        failure
            Why it failed; empty if it did not.

        Raises
        ------
        StudyError
            If the study does not permit the parameters or the context, or knows no such names.
        MetricsError
            As `tell`.
        RunError
            If the tuner is closed, or the trials have ended.
        """
        with self._one_thread:
            self._run.check()
            plan = self._trials()
            added = EarlierRun(parameters, metrics, context, failure, self._errors(errors))
            make = added_trial(self._run.study, self._run.method, added)
            with self._working():
                planned = self._take_back()
                self._note_event(EventKind.ADD, added, planned)
                plan.add(planned, make)
                self._plan_anew()

    def withdraw(self, trial: int, reason: str) -> None:
        """Take back what a trial says of its parameters, as something was wrong with its runs.

        It stays on record with the reason, does not count in the budget, and its parameter set may
        be proposed again.

        Parameters
        ----------
        trial
            Its number.
        reason
            Why, in a line.

        Raises
        ------
        UnknownRunError
            If there is no such trial, it has not ended, or was withdrawn already.
        RunError
            If the tuner is closed, or the trials have ended.
        """
        with self._one_thread:
            self._run.check()
            plan = self._trials()
            why = brief(checks.text(reason, "reason")) or "no reason given"
            is_number = isinstance(trial, int) and not isinstance(trial, bool)
            if not is_number or not 0 <= trial < len(plan.trials):
                ended = f"0 to {len(plan.trials) - 1}" if plan.trials else "none"
                raise UnknownRunError(
                    f"trial {checks.show(trial)}: has not ended; those that have: {ended}"
                )
            if plan.trials[trial].was_withdrawn:
                raise UnknownRunError(f"trial {trial}: {plan.trials[trial].reason}")
            with self._working():
                planned = self._take_back()
                self._note_event(EventKind.WITHDRAW, Withdrawal(trial, why), planned)
                plan.withdraw(trial, why)
                self._plan_anew()

    def fail(self, run: Run, reason: str) -> None:
        """Take that a run failed for its parameters; raises as `tell`."""
        self.tell_outcome(run, failed(str(reason)))

    def lose(self, run: Run, reason: str = "") -> None:
        """Take that a run came to nothing for reasons that say nothing about its parameters.

        It is asked for again, once in a trial. Three trials in a row without a result end the run,
        until it is continued.

        Raises
        ------
        UnknownRunError
            As `tell`.
        RunError
            If the tuner is closed, or now ends.
        """
        why = brief(str(reason)) or "no reason given"
        self.tell_outcome(run, Outcome(EvaluationState.LOST, {}, why))

    def tell_outcome(self, run: Run, outcome: Outcome) -> None:
        """Take what came of a run; not part of the interface."""
        with self._one_thread:
            pending = self._awaited(run)
            with self._working():
                if pending.parts and outcome.state is EvaluationState.LOST:
                    # It is run again, and what was told of it is of no run that counts.
                    self._note_event(EventKind.PART, _PartOfRun(_text(pending.due), None))
                del self._pending[_key(pending.due)]
                try:
                    pending.due = pending.runs.send(outcome)
                except StopIteration as end:
                    seconds = time.monotonic() - pending.begin
                    self._take(replace(pending.planned, outcome=end.value, seconds=seconds))
                else:
                    pending.asked_for = False
                    self._pending[_key(pending.due)] = pending

    def result(self) -> Result:
        """Return what is known so far; once `ask` has returned None, the result."""
        return load(self._run.path, keep=self._run.temporary)

    def close(self) -> None:
        """Let others work in the folder; what was asked for and not told is asked for again."""
        with self._one_thread:
            self._run.close()

    @contextlib.contextmanager
    def _working(self) -> Iterator[None]:
        """Compute as the commands do; what interrupts that closes the tuner, on a whole record."""
        self._run.check()
        try:
            # More than one thread only slows down the small matrices of the surrogates.
            with self._threads.limit(limits=1):
                yield
        except BaseException:
            self.close()
            raise

    def carry_out(self, backend: Backend) -> None:
        """Have a backend run all that is to be asked for; not part of the interface."""
        if self._over:
            return
        with opened_backend(backend):
            while not self._over:
                for evaluation in backend.run(self._due()):
                    with self._working():
                        self._take(evaluation)

    def _errors(self, given: Mapping[str, float] | None) -> Mapping[str, float]:
        """Return known standard errors, checked."""
        self._check_knows(given, "errors")
        return self._returned.errors({} if given is None else given)

    def _as_set(self, run: Run, given: Mapping[str, Value] | None) -> Mapping[str, Value]:
        """Return the values that are not those of a run, checked."""
        self._check_knows(given, "parameters")
        if not given:
            return {}
        checks.mapping(given, "parameters")
        asked = run.evaluation.parameters
        try:
            whole = self._run.study.search_space().permitted({**asked, **given})
        except (ParameterError, ConditionError) as error:
            raise StudyError(str(error), ("parameters",)) from None
        self._run.study.check_given(given, whole, "parameters")
        return {name: value for name, value in whole.items() if value != asked[name]}

    def _check_knows(self, given: object, what: str) -> None:
        """Refuse what the models of some methods do not know."""
        if given and not self._run.method.takes_parts():
            raise StudyError(
                "the models of this algorithm know none; boundary and safe do", (what,)
            )

    def _trials(self) -> TrialPlan:
        """Return the trials, unless they have ended."""
        if not isinstance(self._plan, TrialPlan):
            raise RunError("the trials have ended; begin a new run with these as earlier ones")
        return self._plan

    def _take_back(self) -> int:
        """Take back what nobody was asked for; returns how many tasks stay."""
        return 0 if self._steps is None else self._steps.take_back()

    def _plan_anew(self) -> None:
        if self._steps is not None:
            self._note(self._steps.begin())
            self._go_on()

    def _note_event(self, kind: EventKind, what: object, planned: int = 0) -> None:
        """Put on record what has come from outside."""
        phase = Phase.TUNING if self._plan is None else self._plan.phase
        self._run.observers.event(Event(phase, planned, kind, json.dumps(to_json(what))))

    def _due(self) -> Iterator[Evaluation]:
        """Yield what can be run now; pulled when there is room for it."""
        while not self._over:
            with self._working():
                planned = self._next_planned()
            if planned is None:
                return
            yield planned

    def _awaited(self, run: Run) -> _Pending:
        if not isinstance(run, Run):
            raise UnknownRunError(f"expected a run that was asked for, found {checks.show(run)}")
        pending = self._pending.get(_key(run.evaluation))
        if pending is None or not pending.asked_for:
            place = run.evaluation.place
            why = "the run is over" if self._over else "told already, or asked for by another tuner"
            raise UnknownRunError(f"nobody waits for {place}: {why}")
        if run != (asked := Run.of(pending.due, self._run.study)):
            names = [f.name for f in fields(Run) if getattr(run, f.name) != getattr(asked, f.name)]
            raise UnknownRunError(
                f"{run.evaluation.place}: {' and '.join(names)} are not those that were asked for; "
                "tell a run as it was asked for"
            )
        return pending

    def _next_run(self) -> Run | None:
        """Return the next run: what an evaluation has beside it comes first."""
        waiting = next((item for item in self._pending.values() if not item.asked_for), None)
        if waiting is None:
            planned = self._next_planned()
            if planned is None:
                return None
            runs = self._beside.runs(planned)
            waiting = _Pending(planned, runs, next(runs))
            waiting.parts = self._parts.pop(_text(waiting.due), [])
            self._pending[_key(waiting.due)] = waiting
        waiting.asked_for = True
        return Run.of(waiting.due, self._run.study)

    def _next_planned(self) -> Evaluation | None:
        """Return the next evaluation to run, and take all ahead of it that are on record."""
        while self._steps is not None:
            planned = next(self._steps.due(), None)
            if planned is None:
                return None
            recorded = self._run.on_record.take(planned)
            if recorded is None:
                return planned
            self._take(recorded)
        return None

    def _all_phases(self) -> Phases[Conclusion | None]:
        """Yield the plans of the run, one after the other: those of ``tune``."""
        run = self._run
        trials = TrialPlan(run.study, run.method, run.known)
        had = sum(trial.origin == ADDED for trial in run.known)
        for event in [e for e in run.events if e.kind is EventKind.ADD][had:]:
            # It was to become a trial when the session ended.
            added = read(EarlierRun, json.loads(event.detail), JSON)
            trials.add(event.tasks, added_trial(run.study, run.method, added))
        yield trials
        return (yield from concluding(run.study, run.method, trials.trials))

    def _take(self, evaluation: Evaluation) -> None:
        if self._steps is not None:
            self._note(self._steps.take(evaluation))
            self._go_on()

    def _next_phase(self) -> None:
        observers = self._run.observers
        if self._plan is not None:
            observers.end(self._plan.phase)
        try:
            self._plan = plan = next(self._phases)
        except StopIteration as end:
            self._steps, self._over = None, True
            self._run.finish(end.value)
            return
        observers.begin(plan.phase, plan.steps)
        self._steps = Steps(plan, observers, window=self._run.window)
        self._note(self._steps.begin())
        self._go_on()

    def _go_on(self) -> None:
        if self._steps is not None and self._steps.over:
            self._next_phase()

    def _note(self, tasks: Iterator[Any]) -> None:
        """Note the trials among the tasks that a plan has the results of."""
        for task in tasks:
            if isinstance(self._plan, TrialPlan):
                trial = self._plan.trials[-1]
                if trial.origin == ADDED and not task.recorded:
                    for evaluation in trial.evaluations:
                        self._run.observers.evaluation(evaluation)
                self._run.note_trial(self._plan.trials, recorded=task.recorded)


def _key(evaluation: Evaluation) -> tuple[object, ...]:
    """Return the key of a run among those that are waited for."""
    place = (Stage(evaluation.stage), evaluation.trial, evaluation.index, evaluation.seed)
    return (*place, parameter_set(evaluation.parameters))


def _text(evaluation: Evaluation) -> str:
    """Return the same as text."""
    return json.dumps(to_json(_key(evaluation)))


def _joined(parts: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the entries of all of them; a later one replaces an earlier one."""
    return {name: value for part in parts for name, value in part.items()}


def opened(
    study: Study,
    path: Path,
    algorithm: str | None,
    window: int,
    *,
    by_backend: bool = False,
    temporary: object = None,
    display: RunObserver = NOBODY,
    earlier: Iterable[EarlierRun] = (),
) -> Tuner:
    """Begin a run in a folder, or continue the one that is there; raises as `Study.tuner`.

    Parameters
    ----------
    study, path, algorithm, window, temporary, display, earlier
        As of `OpenRun`.
    by_backend
        Whether a backend runs the evaluations; it runs the default beside them where limits are
        relative to that.
    """
    checks.integer(window, "window", at_least=1, at_most=LARGEST_WINDOW)
    name = algorithm or method_of(study)
    checks.choice(name, tuple(METHODS), "algorithm")
    record = _recorded(study, path, algorithm)
    if record is not None:
        name, window = record.algorithm, record.options.window
    if problem := problem_of(name, study):
        raise StudyError(problem, ("algorithm",))
    check_ends_early(study, FUNCTION)
    if window > 1 and study.relative_metrics and not by_backend:
        raise StudyError(
            f"expected 1, since limits are relative to the default, found {window}", ("window",)
        )
    return Tuner(OpenRun(study, path, name, window, temporary, display, earlier))


def _recorded(study: Study, path: Path, algorithm: str | None) -> RunRecord | None:
    """Return the run in a folder; None where there is none yet."""
    if not OpenRun.begun(path):
        return None
    record = read_run(path)
    if record.backend != FUNCTION:
        raise RunRecordError(
            f"{path}: is a run on {record.backend}, not of a function; continue it with tune"
        )
    if algorithm not in (None, record.algorithm):
        raise RunRecordError(f"{path}: is of the algorithm {record.algorithm}, not {algorithm}")
    if changed := _changed(record.study, study):
        raise RunRecordError(
            f"{path}: is of another study: {summarized(changed)}; take another folder"
        )
    return record


def _changed(then: Study, now: Study) -> list[str]:
    """Return what has changed between two sessions, but for a budget with more trials."""
    before, budget = then.budget, now.budget
    if budget.trials >= before.trials:
        trials = replace(before, trials=budget.trials, evaluations=budget.evaluations)
        more = before.evaluations is None or (budget.evaluations or 0) >= before.evaluations
        if more and trials == budget:
            then = replace(then, budget=budget)
    return changes(then, now)
