"""Evaluations on plain objects in this process, without ROS.

The study names a class for each node. An object takes ``set_parameters(values)``, refusing by
ValueError; the trigger's object runs an evaluation by ``run_cut(*others)``, the others being the
objects of the remaining nodes in the study's order, and returns what its node would publish; the
others give theirs by ``cut_result()``.
"""

from collections.abc import Mapping
from typing import Any

from bo_tuner.backends.protocol import SequentialBackend
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.metrics.collect import STATUS_OK, Collector
from bo_tuner.study import named_code
from bo_tuner.study.parts import IN_PROCESS
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, EvaluationState, Outcome


class InProcessBackend(SequentialBackend):
    """Runs the study's objects.

    Parameters
    ----------
    study
        The study.
    """

    name = IN_PROCESS

    def __init__(self, study: Study) -> None:
        self._study = study
        self._collector = Collector(study)
        self._objects: dict[str, Any] = {}
        self._triggered = ""

    def open(self) -> None:
        """Make the objects, and give them the study's constant parameters and then its defaults.

        Raises
        ------
        StudyError
            If the study describes a run of ROS nodes, a node has no object, it cannot be
            imported, or it refuses a parameter.
        """
        self._triggered = triggered(self._study)
        for key, node in self._study.nodes.items():
            if not node.object:
                raise StudyError(
                    "no object; expected module:Class for the in-process backend",
                    ("nodes", key, "object"),
                )
            # Foreign code, which may raise anything.
            try:
                self._objects[key] = named_code.load(node.object)()
            except Exception as error:
                raise StudyError(
                    f"cannot load {node.object}: {type(error).__name__}: {error}",
                    ("nodes", key, "object"),
                ) from error
            try:
                self._objects[key].set_parameters(
                    dict(node.parameters) | dict(node.inprocess_parameters)
                )
            except Exception as error:
                raise StudyError(_reason(error), ("nodes", key, "parameters")) from error
        # What an object never takes would cost all trials.
        defaults = self._study.search_space().defaults
        for key, values in self._study.nominal_assignments(defaults).items():
            try:
                self._objects[key].set_parameters(values)
            except Exception as error:
                problem = f"refuses the defaults of the study: {_reason(error)}"
                raise StudyError(problem, ("nodes", key)) from error

    def outcome(self, planned: Evaluation) -> Outcome:
        """Set parameters, run one evaluation, and collect its metrics."""
        assignments = self._study.assignments(planned.parameters, planned.context, planned.seed)
        if not self._objects:
            raise BackendError("the backend is not open")
        # Foreign code: whatever it raises is a failed evaluation with its reason, never a lost run.
        for key, values in assignments.items():
            try:
                self._objects[key].set_parameters(values)
            except Exception as error:
                return Outcome(
                    EvaluationState.FAILED, {}, f"{key} refused its parameters: {_reason(error)}"
                )
        trigger = self._triggered
        others = {k: o for k, o in self._objects.items() if k != trigger}
        try:
            answer = self._objects[trigger].run_cut(*others.values())
            said = {trigger: answer}
            if isinstance(answer, Mapping) and answer.get("status") == STATUS_OK:
                said |= {key: other.cut_result() for key, other in others.items()}
            return self._collector.outcome(said, assignments)
        except Exception as error:
            return Outcome(EvaluationState.FAILED, {}, f"{type(error).__name__}: {error}")

    def close(self) -> None:
        """Forget the objects."""
        self._objects.clear()


def _reason(refusal: Exception) -> str:
    return str(refusal) if isinstance(refusal, ValueError) else repr(refusal)


def triggered(study: Study) -> str:
    """Return the key of the node whose object runs an evaluation.

    Raises
    ------
    StudyError
        If there is none.
    """
    if study.trigger is None:
        raise StudyError("needs ROS nodes; use --backend ros", ("run",))
    return study.trigger.node
