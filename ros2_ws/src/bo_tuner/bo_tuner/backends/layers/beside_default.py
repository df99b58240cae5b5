"""The default beside each evaluation, for metrics that are relative to it."""

from collections.abc import Callable, Generator, Mapping
from dataclasses import replace

from bo_tuner.backends.layers.layer import Layer, Run
from bo_tuner.metrics.collect import metric_problem
from bo_tuner.run_notes import Unusable
from bo_tuner.study.study import Study
from bo_tuner.text import brief
from bo_tuner.trials import (
    Evaluation,
    EvaluationState,
    Outcome,
    Value,
    parameter_set,
)

_Draw = tuple[tuple[tuple[str, Value], ...], int]


def beside_default(study: Study, ended: Callable[[], object]) -> Layer:
    """Run the default ahead of each evaluation where it is needed; `ended` is told that it is done.

    A study without metrics that are relative to the default needs none.
    """
    beside = DefaultBeside(study)

    def layer(run: Run) -> Run:
        def with_default(planned: Evaluation) -> Outcome:
            runs = beside.runs(planned)
            due = next(runs)
            while True:
                outcome = run(due)
                if due is not planned:
                    ended()
                try:
                    due = runs.send(outcome)
                except StopIteration as end:
                    result: Outcome = end.value
                    return result

        return with_default

    return layer


class DefaultBeside:
    """Runs the default in the draw of each evaluation: in the same context, with the same seed.

    What it has in a draw is kept, so that it is run once for all evaluations in it. An evaluation
    of the default itself needs no other.
    """

    def __init__(self, study: Study) -> None:
        self._study = study
        self._metrics = study.relative_metrics
        self._default = study.search_space().defaults
        self._known: dict[_Draw, Mapping[str, float]] = {}

    def runs(self, planned: Evaluation) -> Generator[Evaluation, Outcome, Outcome]:
        """Yield what to run for an evaluation, one after the other, and be sent the outcomes."""
        if not self._metrics:
            return (yield planned)
        draw = (tuple(sorted(planned.context.items())), planned.seed)
        if planned.parameter_set == parameter_set(self._default):
            outcome = yield planned
            if outcome.complete:
                self._known[draw] = outcome.metrics
            return self._completed(outcome, outcome.metrics)
        if draw not in self._known:
            # What it has in full is what others are compared with.
            default = yield replace(planned, parameters=self._default, beyond={})
            if not default.complete:
                return _without_default(default)
            self._known[draw] = default.metrics
            outcome = (yield planned).with_starts(default.notes.starts, default.notes.start_seconds)
            return self._completed(outcome, default.metrics)
        return self._completed((yield planned), self._known[draw])

    def _completed(self, outcome: Outcome, default: Mapping[str, float]) -> Outcome:
        """Return an outcome with its relative metrics; `default` are the metrics of the default."""
        if not outcome.complete:
            return outcome
        metrics = dict(outcome.metrics)
        has: dict[str, float] = {}
        for name, metric in self._metrics.items():
            metrics[name] = metric.value(metrics, default)
            has[metric.relative] = default[metric.relative]
            if problem := metric_problem(metrics[name]):
                reason = f"metric {name} is {problem}"
                failed = replace(outcome, state=EvaluationState.FAILED, metrics={}, reason=reason)
                return failed.noted(default=has)
        ordered = {name: metrics[name] for name in self._study.metrics}
        return replace(outcome, metrics=ordered).noted(default=has)


def _without_default(default: Outcome) -> Outcome:
    """Return the outcome of an evaluation ahead of which the default has failed."""
    how = "was lost" if default.state is EvaluationState.LOST else "failed"
    reason = brief(
        f"the default, to which limits are relative, {how} in this context: {default.reason}"
    )
    if default.state is EvaluationState.LOST:
        return replace(default, reason=reason)
    unusable = default.notes.unusable or Unusable.UNPREPARED
    return replace(default, reason=reason).noted(unusable=unusable)
