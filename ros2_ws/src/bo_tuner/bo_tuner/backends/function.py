"""Evaluations by a Python function, which has no nodes."""

from collections.abc import Callable, Mapping
from typing import Any

from bo_tuner.backends.protocol import SequentialBackend
from bo_tuner.codec import checks
from bo_tuner.errors import Failed, MetricsError, StudyError
from bo_tuner.metrics.collect import STATUS_OK, Collector
from bo_tuner.study.function_study import FUNCTION, problem_of_returned, returned_metrics
from bo_tuner.study.named_code import described
from bo_tuner.study.study import Study
from bo_tuner.text import brief
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Value

Function = Callable[[dict[str, Value], dict[str, Value], int], Mapping[str, float]]
"""Runs once: takes parameters and context by name, and the seed of the noise; returns the metrics
by name, or raises `Failed`."""


class Returned:
    """Makes the outcome of an evaluation of what a function has returned."""

    def __init__(self, study: Study) -> None:
        self._metrics = returned_metrics(study)
        self._collector = Collector(study)

    def outcome(self, returned: object, errors: Mapping[str, float] | None = None) -> Outcome:
        """Judge what was returned; a value that is not finite is a failed evaluation.

        `errors` are the known standard errors of metrics, by name.
        """
        if problem := problem_of_returned(self._metrics, returned):
            raise MetricsError(brief(problem))
        known = self.errors(errors or {})
        values: Mapping[str, object] = returned  # type: ignore[assignment]
        said: dict[str, dict[str, object]] = {}
        for name, metric in self._metrics.items():
            of_node = said.setdefault(metric.node, {"status": STATUS_OK})
            of_node[metric.key] = float(values[name])  # type: ignore[arg-type]
        return self._collector.outcome(said).noted(errors=known)

    def part(self, returned: object) -> Mapping[str, float]:
        """Return some of the metrics, checked."""
        values: Mapping[str, Any] = returned if isinstance(returned, Mapping) else {}
        if unknown := [name for name in values if name not in self._metrics]:
            known = ", ".join(self._metrics)
            raise MetricsError(brief(f"{unknown[0]!r} is no metric; expected some of {known}"))
        of_part = {name: self._metrics[name] for name in values} or self._metrics
        if problem := problem_of_returned(of_part, returned):
            raise MetricsError(brief(problem))
        return {name: float(value) for name, value in values.items()}

    def errors(self, given: Mapping[str, float]) -> dict[str, float]:
        """Return standard errors of metrics, checked."""
        try:
            checks.mapping(given)
            known = {}
            for name, error in given.items():
                checks.reference(name, "metric", self._metrics, name)
                known[name] = checks.number(error, name)
                if known[name] <= 0.0:
                    raise StudyError(
                        f"expected a positive number, found {known[name]:g}; leave out what is "
                        "not known",
                        (name,),
                    )
        except StudyError as error:
            raise MetricsError(str(error.under("errors"))) from None
        return known


def failed(reason: str) -> Outcome:
    """Return the outcome of an evaluation that failed for its parameters."""
    return Outcome(EvaluationState.FAILED, {}, brief(reason) or "no reason given")


class FunctionBackend(SequentialBackend):
    """Calls a function."""

    name = FUNCTION

    def __init__(self, study: Study, function: Function) -> None:
        super().__init__(study)
        self._study = study
        self._function = function
        self._returned = Returned(study)

    def open(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""

    def outcome(self, planned: Evaluation) -> Outcome:
        """Call the function; any exception but those that end a program is a failed evaluation."""
        try:
            parameters = self._study.as_given(planned.parameters)
            returned = self._function(parameters, dict(planned.context), planned.seed)
        except Failed as error:
            return failed(str(error))
        except Exception as error:
            return failed(described(error))
        return self._returned.outcome(returned)
