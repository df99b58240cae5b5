"""What nodes are set to when a backend opens, and why one will not take it."""

from collections.abc import Mapping

from bo_tuner.backends.ros.errors import RefusedError
from bo_tuner.backends.ros.graph import describe_now
from bo_tuner.backends.ros.node_parameters import NodeParameters, Values
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.errors import BackendError, KeyPath, StudyError
from bo_tuner.study.descriptors import node_problems
from bo_tuner.study.study import Study


class InitialParameters:
    """Sets what a study sets outside of evaluations; a refusal names the place in the study.

    All methods raise `StudyError` if a node does not take a value, and `LostError` if it does not
    answer.

    Parameters
    ----------
    study
        The study.
    tuner
        The tuner's node.
    parameters
        Sets and reads those of the nodes.
    """

    def __init__(self, study: Study, tuner: TunerNode, parameters: NodeParameters) -> None:
        self._study = study
        self._tuner = tuner
        self._parameters = parameters

    def set_constants(self) -> None:
        """Set the constants of the nodes, and read them back."""
        for key, spec in self._study.nodes.items():
            try:
                self._parameters.assign_and_read_back(key, spec.parameters)
            except RefusedError as refusal:
                raise self._named(key, refusal, ("nodes", key, "parameters")) from refusal

    def set_undeclared(self, found: Mapping[str, Mapping[str, object]]) -> None:
        """Set safe values of what nodes have not declared: what is never taken costs all trials.

        Parameters
        ----------
        found
            What the nodes have declared, by key.
        """
        safe = self._study.nominal_assignments(self._study.safe_parameters)
        for key, values in safe.items():
            undeclared = {name: v for name, v in values.items() if name not in found[key]}
            try:
                self._parameters.assign(key, undeclared)
            except RefusedError as refusal:
                raise self._named(key, refusal, ("nodes", key)) from refusal

    def set_safe(self, safe: Values) -> None:
        """Set safe values, and read them back."""
        section = "park" if self._study.park.parameters else "parameters"
        for key, values in safe.items():
            try:
                self._parameters.assign_and_read_back(key, values)
            except RefusedError as refusal:
                raise self._named(key, refusal, (section,), "as safe values: ") from refusal

    def refuse_ranges(self) -> None:
        """Refuse a study with values that a node says it does not take: they would fail runs."""
        for key in self._study.nodes:
            for problem in self._problems(key, declared=True):
                raise problem

    def _named(
        self, key: str, refusal: RefusedError, path: KeyPath, prefix: str = ""
    ) -> StudyError:
        """Return what the study sets that the node cannot take, or the node's refusal itself."""
        found = self._problems(key, declared=False)
        return found[0] if found else StudyError(f"{prefix}{refusal}", path)

    def _problems(self, key: str, *, declared: bool) -> list[StudyError]:
        """Return as `node_problems`; none of a node that does not describe its parameters."""
        try:
            # The tuner has told it something by now, and has noted that down.
            known = describe_now(self._tuner, self._study.nodes[key].node)
        except BackendError:
            return []
        return node_problems(self._study, key, known, declared=declared)
