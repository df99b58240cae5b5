"""What the backend does with a study's nodes: sets their parameters, and evaluates."""

import time
from collections.abc import Callable, Collection, Iterable, Mapping

from bo_tuner.backends.ros.errors import DisturbedError, LostError
from bo_tuner.backends.ros.parameters.approach import Approach
from bo_tuner.backends.ros.parameters.events import Values
from bo_tuner.backends.ros.parameters.nodes import NodeParameters
from bo_tuner.backends.ros.presence import Presence
from bo_tuner.backends.ros.start_values import StartValues
from bo_tuner.backends.ros.started_nodes import StartedNodes
from bo_tuner.backends.ros.trigger import TriggeredRun
from bo_tuner.backends.ros.tuner_node import CALL_TIMEOUT, TunerNode
from bo_tuner.metrics.recording import FailedRunError
from bo_tuner.study.study import Study
from bo_tuner.trials import Value

LONGEST_LEASE = 21.0
"""Time [s] after which a killed node is forgotten for sure, with Fast DDS as it is by default."""


class StudyClient:
    """The tuner's connection to the nodes of a study.

    Attributes
    ----------
    parameters : NodeParameters
        The nodes' parameters.
    approach : Approach
        Takes the nodes to other parameters in small steps.
    start_values : StartValues
        Those that act only at a start.
    presence : Presence
        What the graph says of them.
    results : RunResults
        What they say of the present evaluation.
    rounded : list of tuple
        Key, name and value of each parameter that a node had in the last evaluation in fewer
        digits than were set; of an array a list as JSON.
    """

    def __init__(self, study: Study, tuner: TunerNode, started: StartedNodes | None) -> None:
        self._study = study
        self._renewed: set[str] = set()
        self.rounded: list[tuple[str, str, Value]] = []
        nodes = {key: spec.node for key, spec in study.nodes.items()}
        self.parameters = NodeParameters(
            tuner,
            nodes,
            study.own_parameters,
            lambda key, name: study.nodes[key].unwatched_by(name),
        )
        self.approach = Approach(study, tuner, self.parameters)
        self.start_values = StartValues(study, tuner, self.parameters, started)
        self._triggered = TriggeredRun(study, tuner, self.parameters)
        self.results = self._triggered.results
        self.presence = Presence(study, tuner, self.parameters, self._triggered.service)

    def restarted(self) -> list[str]:
        """Return the keys of nodes that were started anew since this was last asked.

        Their parameters are set again in the next evaluation.
        """
        keys = self.presence.restarted()
        for key in keys:
            self._renewed.add(key)
            self.parameters.forget(key)
            self.start_values.forget(key)
        return keys

    def renew(self, keys: Iterable[str]) -> None:
        """Read the parameters of nodes that were started anew, before any of them is set."""
        for key in list(keys):
            self.parameters.read_anew(key)
            self._renewed.discard(key)

    def evaluate(
        self,
        wanted: Values,
        kept: Mapping[str, Collection[str]],
        run: Callable[[], object] | None = None,
        leave: Callable[[], object] = lambda: None,
    ) -> dict[str, dict[str, object]]:
        """Set parameters, run an evaluation, and see that it ran with them."""
        self.restarted()
        for key in self._renewed:
            self.presence.meet(key, time.monotonic() + CALL_TIMEOUT)
        self.renew(self._renewed)
        self._refuse_twins()
        self.parameters.expect(wanted)
        self.start_values.bring(wanted)
        self.approach.to_held(wanted, kept)
        self.parameters.hold(wanted, kept)
        self.results.begin()
        try:
            try:
                said = self._triggered.run() if run is None else {}
                if run is not None:
                    run()
            except (FailedRunError, DisturbedError) as error:
                disturbance = self.parameters.disturbance()
                # That a node was started anew explains the rest: a gap in a signal, two publishers.
                self._refuse_other_nodes()
                raise (disturbance or error) from None
            readback = self.parameters.read_back()
            leave()
            # A node that was killed stays in the graph as long as its lease.
            self._refuse_other_nodes()
            readback.check()
            self.rounded = [
                (key, name, value if isinstance(value, bool | int | float | str) else str(value))
                for key, name, value in readback.rounded()
            ]
            if self.results.problem:
                raise DisturbedError(self.results.problem)
            if self.results.contradicted:
                raise DisturbedError(
                    f"{self.results.contradicted[0]}: two different results of one test run"
                )
            return said
        finally:
            self.results.end()

    def assign_again(self, key: str) -> None:
        """Set the parameters of this evaluation again on a node that the tuner has restarted."""
        self.restarted()
        self.renew([key])
        self.start_values.settle(key)
        self.parameters.hold_again(key)

    def _refuse_other_nodes(self) -> None:
        """Refuse an evaluation after which the nodes are not those that it began with."""
        anew = self.restarted()
        # A second node of this name shows in the graph like one that was started anew.
        self._refuse_twins()
        if anew:
            name = self._study.nodes[anew[0]].node
            raise LostError(f"{name} was started anew during the test run")

    def _refuse_twins(self) -> None:
        if twins := self.presence.twins(LONGEST_LEASE):
            raise DisturbedError(twins)
