"""Evaluations on plain objects in this process, without ROS.

The study names a class for each node. An object takes ``set_parameters(values)``, refusing by
ValueError; the trigger's object runs an evaluation by ``evaluate(*others)``, the others being the
objects of the remaining nodes in the study's order, and returns what its node would publish; the
others give theirs by ``result()``. Where runs may be cut short, the trigger's object also takes
``end_beyond(values)``: by the keys of its metrics that only grow, the values beyond which the next
run is to end. What it returns of a run that it has ended has the status ``cut short``, the time
``after`` of the run [s], and all these metrics as they are by then.
"""

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from bo_tuner.backends.protocol import SequentialBackend
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.interruption import breaking_off
from bo_tuner.metrics.collect import (
    STATUS_CUT_SHORT,
    STATUS_OK,
    Collector,
    cut_short,
    metric_problem,
)
from bo_tuner.study import named_code
from bo_tuner.study.metrics import ReportedMetric
from bo_tuner.study.parts import IN_PROCESS
from bo_tuner.study.study import Study
from bo_tuner.text import brief
from bo_tuner.trials import Evaluation, EvaluationState, Outcome


class InProcessBackend(SequentialBackend):
    """Runs the study's objects."""

    name = IN_PROCESS

    def __init__(self, study: Study, interrupted: Callable[[], None] = lambda: None) -> None:
        super().__init__(study)
        self._study = study
        self._interrupted = interrupted
        self._collector = Collector(study)
        self._objects: dict[str, Any] = {}
        self._triggered = ""

    def open(self) -> None:
        """Make the objects, and give them the study's constant parameters and then its defaults."""
        self._triggered = triggered(self._study)
        self._check_bounds()
        for section in ("parameters", "contexts"):
            for name, item in getattr(self._study, section).items():
                if not item.node:
                    raise StudyError(
                        "missing; no object is started with it", (section, name, "node")
                    )
        for key, node in self._study.nodes.items():
            if not node.object:
                raise StudyError(
                    "no object; expected module:Class for the in-process backend",
                    ("nodes", key, "object"),
                )
            try:
                with self._foreign():
                    self._objects[key] = named_code.load(node.object, self._study.folder)()
            except named_code.faults() as error:
                raise StudyError(
                    f"cannot load {node.object}: {named_code.described(error)}",
                    ("nodes", key, "object"),
                ) from error
            try:
                with self._foreign():
                    self._objects[key].set_parameters(
                        dict(node.parameters) | dict(node.inprocess_parameters)
                    )
            except named_code.faults() as error:
                raise StudyError(_reason(error), ("nodes", key, "parameters")) from error
        if self._study.budget.cut_short:
            _check_ends_early(self._triggered, self._objects[self._triggered])
        # What an object never takes would cost all trials.
        defaults = self._study.search_space().defaults
        for key, values in self._study.nominal_assignments(defaults).items():
            try:
                with self._foreign():
                    self._objects[key].set_parameters(values)
            except named_code.faults() as error:
                problem = f"refuses the defaults of the study: {_reason(error)}"
                raise StudyError(problem, ("nodes", key)) from error

    def outcome(self, planned: Evaluation) -> Outcome:
        """Set parameters, run one evaluation, and collect its metrics."""
        assignments = self._study.assignments(planned.parameters, planned.context, planned.seed)
        if not self._objects:
            raise BackendError("the backend is not open")
        # Whatever foreign code raises is a failed evaluation with its reason, never a lost run.
        for key, values in assignments.items():
            try:
                with self._foreign():
                    self._objects[key].set_parameters(values)
            except named_code.faults() as error:
                return Outcome(
                    EvaluationState.FAILED, {}, f"{key} refused its parameters: {_reason(error)}"
                )
        trigger = self._triggered
        others = {k: o for k, o in self._objects.items() if k != trigger}
        try:
            with self._foreign():
                if self._study.budget.cut_short:
                    self._objects[trigger].end_beyond(self._by_key(planned.beyond))
                answer = self._objects[trigger].evaluate(*others.values())
                said = {trigger: answer}
                if isinstance(answer, Mapping) and answer.get("status") == STATUS_CUT_SHORT:
                    return self._cut_short(planned, answer)
                if isinstance(answer, Mapping) and answer.get("status") == STATUS_OK:
                    said |= {key: other.result() for key, other in others.items()}
                return self._collector.outcome(said, assignments)
        except named_code.faults() as error:
            return Outcome(EvaluationState.FAILED, {}, named_code.described(error))

    def _check_bounds(self) -> None:
        """Refuse to cut runs short by what other nodes report: they do so after a run."""
        study = self._study
        if study.budget.cut_short and not self._own(study.decisive_metrics):
            raise StudyError(
                f"{self._triggered}, which performs a run, reports none of "
                f"{', '.join(study.decisive_metrics)}, by which it could be ended",
                ("budget", "cut_short"),
            )

    def _own(self, names: Iterable[str]) -> dict[str, str]:
        """Return the keys of the metrics among some that the object of the trigger reports."""
        metrics = {name: self._study.metrics[name] for name in names}
        return {
            name: metric.key
            for name, metric in metrics.items()
            if isinstance(metric, ReportedMetric) and metric.node == self._triggered
        }

    def _by_key(self, beyond: Mapping[str, float]) -> dict[str, float]:
        """Return bounds of metrics by the keys of those that the object of the trigger reports."""
        return {key: beyond[name] for name, key in self._own(beyond).items()}

    def _cut_short(self, planned: Evaluation, answer: Mapping[str, Any]) -> Outcome:
        """Return the outcome of a run that the object of the trigger has ended early."""
        after: Any = answer.get("after")
        if problem := metric_problem(after):
            reason = f"{self._triggered}: the time after which it was cut short is {problem}"
            return Outcome(EvaluationState.FAILED, {}, brief(reason))
        own = self._own(self._study.growing_metrics)
        so_far = {name: answer.get(key) for name, key in own.items()}
        return cut_short(self._study, planned.beyond, float(after), so_far, {})

    @contextlib.contextmanager
    def _foreign(self) -> Iterator[None]:
        """Run code of an object, which may do anything: a signal ends it, and it stays in place."""
        with breaking_off(self._interrupted), named_code.kept_in_place():
            yield

    def close(self) -> None:
        """Forget the objects."""
        self._objects.clear()


def _check_ends_early(key: str, item: object) -> None:
    """Refuse an object that cannot end a run before its time."""
    if not callable(getattr(item, "end_beyond", None)):
        raise StudyError(
            "cannot end a run early, which `budget.cut_short` needs; expected a method "
            "end_beyond(values)",
            ("nodes", key, "object"),
        )


def _reason(refusal: BaseException) -> str:
    return str(refusal) if isinstance(refusal, ValueError) else named_code.described(refusal)


def triggered(study: Study) -> str:
    """Return the key of the node whose object runs an evaluation."""
    if study.trigger is None:
        raise StudyError("needs ROS nodes; use --backend ros", ("run",))
    return study.trigger.node
