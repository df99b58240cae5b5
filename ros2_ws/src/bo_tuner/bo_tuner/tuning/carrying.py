"""Trials of an earlier run that a new run begins with, of the same study or a similar one.

An evaluation is a fact about its parameter set in its context: it stays one when a study gets other
bounds, another budget, limit or objective. What is made of it may not:

- A parameter set that the new study does not permit (outside its bounds, off a step, against the
  order, of another fixed value) is left out: models, reports and a result know those only that it
  permits.
- Where the distribution of the contexts has changed, evaluations in contexts that are still
  possible are data of a process over parameter set and context, as `boundary` has it. They are no
  draws any more, so no mean of theirs stands for an expectation: they count as those of a search.
  The other algorithms take means over draws, and are refused, except I, which runs in the nominal
  context alone.
- An estimated worst case is kept where the same metric was searched on the same side, over the same
  contexts. Elsewhere it is estimated anew by the models of all evaluations that are taken; an
  algorithm that only searches trial by trial is refused.
- Hyperparameters are those of the old unit cube and the old responses, and are dropped if anything
  but the amount has changed, or if the earlier run knew a simulation, which the new one does not.
- Trials and evaluations that were lost or disturbed are not informative, and are left out.
"""

import dataclasses
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from bo_tuner.codec import checks
from bo_tuner.errors import ConditionError, ParameterError, RunRecordError, StudyError
from bo_tuner.methods.protocol import Method
from bo_tuner.metrics.collect import judged
from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.optimizers.base import Proposal
from bo_tuner.storage.journal_reader import JournalContent
from bo_tuner.storage.record import RunRecord
from bo_tuner.study.changes import changes_of_data, incomparable_changes, summarized
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.distributions import Discrete, Distribution
from bo_tuner.study.lag_metric import LagMetric
from bo_tuner.study.metrics import (
    COMPUTED,
    PythonMetric,
    RelativeMetric,
    StudyMetric,
    signals_of,
)
from bo_tuner.study.parts import LINEAR
from bo_tuner.study.study import Study
from bo_tuner.text import counted
from bo_tuner.trials import (
    Evaluation,
    Outcome,
    Stage,
    Trial,
    TrialState,
    Value,
    WorstCase,
    count_evaluations,
    ended_as,
)

OF_MEASURING = re.compile(r"\b(metric|signal) ")
"""In the reason of a failure: it lies in how the run was measured."""

Measure = Callable[[Evaluation], Outcome | None]
"""Computes the metrics of an evaluation again, as another study defines them; None if it cannot."""


@dataclass(frozen=True)
class Carried:
    """What a run takes of an earlier one.

    Attributes
    ----------
    run
        The folder of that run.
    trials
        What it takes, numbered from 0.
    text
        What it takes and what it leaves out, with counts and reasons, in a line.
    """

    run: str
    trials: tuple[Trial, ...]
    text: str

    @property
    def content(self) -> JournalContent:
        """What a journal has that begins with it."""
        evaluations = tuple(e for trial in self.trials for e in trial.evaluations)
        return JournalContent((), self.trials, evaluations, "")


class LeftOutError(Exception):
    """A trial or an evaluation cannot be data of the new study, for this reason."""


def is_carried(trial: Trial) -> bool:
    """Whether a trial was taken over from another run."""
    return any(evaluation.outcome.notes.carried_from for evaluation in trial.evaluations)


def remeasured(then: Study, now: Study) -> list[str]:
    """Return the metrics of a study that an earlier one does not have, or measures otherwise."""
    return [
        name
        for name, metric in now.metrics.items()
        if not _same_metric(metric, then.metrics.get(name), then, now)
    ]


def check_comparable(record: RunRecord, study: Study, method: Method) -> None:
    """Refuse a study of which no trial of a run can be data."""
    then = record.study
    if differences := incomparable_changes(then, study):
        raise RunRecordError(f"{record.path}: is a run of another study: {summarized(differences)}")
    moved = _moved_contexts(then, study)
    new = [c.name for c in study.worst_case_constraints if _searched(c, then, study) is None]
    if problem := method.refusal(then, study, moved, new):
        raise RunRecordError(f"{record.path}: {problem}; start a new run")
    if not record.trials:
        raise RunRecordError(f"{record.path}: has no whole trial to begin with")


def carry_over(
    record: RunRecord,
    study: Study,
    method: Method,
    measure: Measure | None = None,
    *,
    run: str = "",
) -> Carried:
    """Take the trials of a run as far as they are data of a study."""
    run = run or str(record.path.resolve())
    taking = Taking(record, study, method, measure, run)
    taken = list(taking.trials())
    if not taken:
        raise RunRecordError(
            f"{record.path}: none of its {counted(len(record.trials), 'trial')} can be used: "
            f"{taking.left_out}"
        )
    trials = _completed(study, method, taken)
    return Carried(run, tuple(_named(trial, run) for trial in trials), taking.summary(trials))


class Taking:
    """Goes through the trials of a run, and counts what it leaves out."""

    def __init__(
        self,
        record: RunRecord,
        study: Study,
        method: Method,
        measure: Measure | None,
        run: str,
    ) -> None:
        self._record = record
        self.run = run
        self._then, self._study, self._method = record.study, study, method
        self._space = study.search_space()
        self._measure = measure
        self._changed = bool(record.simulation or changes_of_data(self._then, study))
        self._anew = set(remeasured(self._then, study))
        self._measured_otherwise = _measured_otherwise(self._then, study, self._anew)
        self._moved = _moved_contexts(self._then, study)
        self._trials: Counter[str] = Counter()
        self._evaluations: Counter[str] = Counter()

    def trials(self) -> Iterator[Trial]:
        """Yield what is taken, numbered from 0; a complete trial may lack worst cases."""
        number = 0
        for trial in self._record.trials:
            try:
                taken = self._trial(trial, number)
            except LeftOutError as reason:
                self._trials[str(reason)] += 1
                continue
            number += 1
            yield taken

    @property
    def left_out(self) -> str:
        """Counts and reasons."""
        kinds = ((self._trials, "trial"), (self._evaluations, "test run"))
        counts = [
            f"{counted(n, kind)} {reason}"
            for reasons, kind in kinds
            for reason, n in reasons.most_common()
        ]
        return "; ".join(counts)

    def summary(self, taken: Sequence[Trial]) -> str:
        """Return what is taken and what is left out, in a line."""
        before = self._record.trials
        text = (
            f"{len(taken)} of {counted(len(before), 'trial')} and {count_evaluations(taken)} of "
            f"{counted(sum(len(t.evaluations) for t in before), 'test run')}"
        )
        return f"{text}; left out: {self.left_out}" if self.left_out else text

    def _trial(self, trial: Trial, number: int) -> Trial:
        if trial.unusable:
            raise LeftOutError(trial.ending)
        self._check_parameters(trial)
        kept, reasons = [], []
        for evaluation in trial.evaluations:
            try:
                kept.append(self._evaluation(evaluation))
            except LeftOutError as reason:
                reasons.append(str(reason))
        if reasons and (not kept or not self._method.takes_parts()):
            # Other methods model a trial by mean and worst case, which need all its evaluations.
            raise LeftOutError(reasons[0])
        self._evaluations.update(reasons)
        evaluations = tuple(
            dataclasses.replace(evaluation, trial=number, index=index)
            for index, evaluation in enumerate(kept)
        )
        failed = [e.outcome for e in kept if not e.outcome.complete]
        state = ended_as(failed[0]) if failed else TrialState.COMPLETE
        return dataclasses.replace(
            trial,
            number=number,
            origin=trial.origin if is_carried(trial) else self._origin(trial),
            state=state,
            reason=failed[0].reason if failed else "",
            evaluations=evaluations,
            worst_cases={} if failed or reasons else self._worst_cases(trial),
            hyperparameters={} if self._changed else trial.hyperparameters,
        )

    def _origin(self, trial: Trial) -> str:
        return f"{trial.origin} (from {self.run}, trial {trial.number})"

    def _check_parameters(self, trial: Trial) -> None:
        """Refuse a parameter set that the study does not permit, and say why in a few words."""
        tuned = {name: trial.parameters[name] for name in self._space.names}
        for name, value in tuned.items():
            item = self._study.parameters[name]
            try:
                self._space.completed(self._space.defaults | {name: value})
                item.check_grid(value, name)
            except ParameterError:
                what = "bounds" if item.is_number else "choices"
                raise LeftOutError(f"outside the {what} of {name}") from None
            except StudyError:
                raise LeftOutError(f"off the step of {name}") from None
        try:
            complete = self._space.permitted(tuned)
        except ConditionError as error:
            raise LeftOutError(f"against the condition {error.condition}") from None
        except ParameterError:
            raise LeftOutError("against the order of the parameters") from None
        for name, value in complete.items():
            # For a node, 3 and 3.0 differ.
            if repr(value) != repr(trial.parameters[name]):
                raise LeftOutError(f"with another value of {name}")

    def _evaluation(self, evaluation: Evaluation) -> Evaluation:
        """Return an evaluation as the study judges it."""
        for name, variable in self._study.contexts.items():
            if not _is_possible(variable.distribution, evaluation.context[name]):
                raise LeftOutError(f"outside the distribution of {name}")
        drawn = evaluation.stage is Stage.DRAWN
        stage = Stage.SEARCH if drawn and self._moved else evaluation.stage
        return dataclasses.replace(
            evaluation, stage=stage, outcome=judged(self._study, self._outcome(evaluation))
        )

    def _outcome(self, evaluation: Evaluation) -> Outcome:
        outcome = evaluation.outcome
        if outcome.was_cut_short:
            return self._bounds(outcome)
        if not outcome.complete:
            if self._measured_otherwise and OF_MEASURING.search(outcome.reason):
                raise LeftOutError("failed by what is measured otherwise now")
            return outcome
        known = {n: outcome.metrics[n] for n in self._study.metrics if n not in self._anew}
        known |= self._relative(known, outcome.notes.default)
        anew = self._anew - known.keys()
        if not anew:
            metrics = {name: known[name] for name in self._study.metrics}
            return dataclasses.replace(outcome, metrics=metrics)
        measured = None if self._measure is None else self._measure(evaluation)
        if measured is None or (measured.complete and not anew <= measured.metrics.keys()):
            raise LeftOutError(f"without a record of {', '.join(sorted(anew))}")
        if not measured.complete:
            return dataclasses.replace(measured, details=outcome.details, notes=outcome.notes)
        metrics = {name: known.get(name, measured.metrics[name]) for name in self._study.metrics}
        return dataclasses.replace(outcome, metrics=metrics)

    def _bounds(self, outcome: Outcome) -> Outcome:
        """Return the outcome of a run that was cut short with the bounds that hold still."""
        kept = self._study.metrics.keys() - self._anew
        bounds = {name: value for name, value in outcome.notes.at_least.items() if name in kept}
        if not bounds or not self._method.takes_parts():
            raise LeftOutError("cut short")
        return outcome.noted(at_least=bounds)

    def _relative(
        self, known: Mapping[str, float], default: Mapping[str, float]
    ) -> dict[str, float]:
        """Return metrics relative to the default, as far as the default's values are on record."""
        if not _same_default(self._then, self._study):
            return {}
        return {
            name: metric.value(known, default)
            for name, metric in self._study.relative_metrics.items()
            if metric.relative in known and metric.relative in default
        }

    def _worst_cases(self, trial: Trial) -> dict[str, WorstCase]:
        """Return the estimates that hold under the study, by the names of its constraints."""
        if not trial.worst_cases:
            return {}
        counterparts = {
            constraint.name: _searched(constraint, self._then, self._study)
            for constraint in self._study.worst_case_constraints
        }
        return {
            name: trial.worst_cases[then] for name, then in counterparts.items() if then is not None
        }


def _completed(study: Study, method: Method, trials: Sequence[Trial]) -> list[Trial]:
    """Estimate the worst cases of complete trials that lack any."""
    names = {constraint.name for constraint in study.worst_case_constraints}
    lacking = [
        trial.number
        for trial in trials
        if trial.state is TrialState.COMPLETE and trial.worst_cases.keys() != names
    ]
    return with_worst_cases(study, method, trials, lacking) if lacking else list(trials)


def with_worst_cases(
    study: Study, method: Method, trials: Sequence[Trial], numbers: Iterable[int]
) -> list[Trial]:
    """Estimate the worst cases of some of the trials, by their numbers, by all evaluations."""
    rng = generator(study.seed, Stream.SEARCH, len(trials))
    known = dict(method.hyperparameters(study, trials, rng))
    updated = list(trials)
    for number in numbers:
        trial = trials[number]
        proposal = Proposal(dict(trial.parameters), trial.origin, hyperparameters=known)
        others = [other for other in trials if other.number != number]
        searches = method.worst_case_searches(study, proposal, others)
        for evaluation in trial.evaluations:
            searches.tell(evaluation.context, evaluation.outcome.metrics)
        rng = generator(study.seed, Stream.SEARCH, number, len(trial.evaluations))
        updated[number] = dataclasses.replace(trial, worst_cases=searches.worst_cases(rng))
    return updated


def _named(trial: Trial, run: str) -> Trial:
    """Let evaluations name the run that they come from, unless they name an earlier one."""
    return dataclasses.replace(
        trial,
        evaluations=tuple(
            dataclasses.replace(
                evaluation,
                outcome=evaluation.outcome.noted(
                    carried_from=evaluation.outcome.notes.carried_from or run
                ),
            )
            for evaluation in trial.evaluations
        ),
    )


def _moved_contexts(then: Study, now: Study) -> list[str]:
    """Return the context variables that have another distribution now."""
    return [
        name
        for name, variable in now.contexts.items()
        if variable.distribution != then.contexts[name].distribution
    ]


def _is_possible(distribution: Distribution, value: Value) -> bool:
    if isinstance(distribution, Discrete):
        return any(checks.same_value(value, possible) for possible in distribution.values)
    return distribution.lower <= distribution.number(value) <= distribution.upper


def _searched(constraint: Constraint, then: Study, now: Study) -> str | None:
    """Return the constraint of an earlier study that searched for the same worst case, if any."""
    if constraint.metric in remeasured(then, now) or _moved_contexts(then, now):
        return None
    same = (
        other.name
        for other in then.worst_case_constraints
        if (other.metric, other.sign) == (constraint.metric, constraint.sign)
    )
    return next(same, None)


def _same_metric(metric: StudyMetric, other: StudyMetric | None, then: Study, now: Study) -> bool:
    """Whether two studies measure the same, whatever its label, unit and scale."""
    if type(metric) is not type(other) or other is None:
        return False
    if _measures(metric) != _measures(other):
        return False
    if isinstance(metric, RelativeMetric) and not _same_default(then, now):
        return False
    if isinstance(metric, COMPUTED) and isinstance(other, COMPUTED):
        pairs = zip(metric.parts, other.parts, strict=True)
        return all(_same_metric(one, earlier, then, now) for one, earlier in pairs)
    if isinstance(metric, PythonMetric):
        return then.signals == now.signals
    used = signals_of(metric, now.signals)
    return all(then.signals.get(name) == now.signals.get(name) for name in used)


def _measures(metric: StudyMetric) -> StudyMetric:
    """Return a metric without what is for display and models only."""
    if isinstance(metric, RelativeMetric | LagMetric):
        return dataclasses.replace(metric, label="", unit="")
    return dataclasses.replace(metric, label="", unit="", scale=LINEAR)


def _same_default(then: Study, now: Study) -> bool:
    return then.search_space().defaults == now.search_space().defaults


def _measured_otherwise(then: Study, now: Study, anew: set[str]) -> bool:
    """Whether what is measured has changed, so that a run that failed in it may not fail now."""
    gone_log = set(then.logarithmic_metrics) - set(now.logarithmic_metrics)
    return bool(
        anew or then.metrics.keys() - now.metrics or then.signals != now.signals or gone_log
    )
