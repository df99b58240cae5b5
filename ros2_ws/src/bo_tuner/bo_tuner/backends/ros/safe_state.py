"""Brings the machine to its safe state: nodes parked, no goal under way, the machine at home."""

from collections.abc import Callable

from bo_tuner.backends.layers.suspension import Suspension
from bo_tuner.backends.ros.errors import LostError
from bo_tuner.backends.ros.parameters.events import Values
from bo_tuner.backends.ros.procedure import Procedure
from bo_tuner.backends.ros.study_client import LONGEST_LEASE, StudyClient
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.storage.trust import python_functions
from bo_tuner.study.study import Study

PARK_TIMEOUT = 2.0
"""Time [s] that all nodes have to be parked: one may be hanging, and the machine is to stop."""


def parks_after_runs(study: Study) -> bool:
    """Return whether the nodes get their safe parameters right after each run."""
    rests = study.run is not None and study.run.rest is not None
    # A function of a metric may take any time, in which nobody watches the machine.
    return study.park.between_runs or rests or bool(python_functions(study))


class SafeState:
    """The safe state of a study's nodes."""

    def __init__(
        self,
        study: Study,
        tuner: TunerNode,
        client: StudyClient,
        parameters: Values,
        held: Values,
        procedure: Procedure | None,
        suspension: Suspension,
        look: Callable[[], None],
    ) -> None:
        self._study = study
        self._tuner = tuner
        self._client = client
        self._parameters = parameters
        self._held = held
        self._procedure = procedure
        self._suspension = suspension
        self._look = look
        self._unfinished: list[str] = []

    def park(self, *, start_anew: bool = True, at_once: bool = False) -> list[str]:
        """Set the safe parameters on all nodes and read them back; returns what went wrong.

        Without `start_anew` a node keeps what it takes only at its start: it is ended next. The
        nodes go there in small steps, if the study says so, unless it is to be `at_once`.
        """
        with self._tuner.watched_by(self._look):
            return self._park(start_anew, at_once=at_once)

    def park_after_run(self) -> None:
        """Park the nodes in an evaluation; `take_unfinished` returns what went wrong."""
        self._unfinished += self._park(self._study.park.between_runs, at_once=False)

    def stop(self) -> list[str]:
        """Bring a run to its end at once, whatever interrupts it; returns what is not parked.

        `take_unfinished` returns what else was not possible.
        """
        if self._procedure is None:
            return []
        with self._tuner.watched_by(self._suspension.look):
            self._procedure.request_cancel()
            problems = self._park()
            self._unfinished += self._procedure.leave()
            # A node may refuse parameters while it executes a goal.
            return problems and self._park()

    def recover(self) -> list[str]:
        """Leave the machine safe, and home, after a run that failed; returns what went wrong."""
        if self._procedure is None:
            return self.park(at_once=True)
        # With the parameters of the trial the machine does not drive home.
        if problems := self.stop():
            return problems
        # It does not while two nodes of a name run either: one of them may not be parked.
        try:
            twins = self._client.presence.twins(LONGEST_LEASE)
        except LostError as loss:
            twins = str(loss)
        if twins:
            return [f"not recovered: {twins}"]
        problems = self._procedure.recover()
        return problems and problems + self.stop()

    def take_unfinished(self) -> list[str]:
        """Return, and forget, what went wrong when an evaluation was left safe."""
        problems, self._unfinished = self._unfinished, []
        return problems

    def _park(self, start_anew: bool = True, *, at_once: bool = True) -> list[str]:
        parameters, anew = self._client.parameters, self._client.start_values
        safe, held = self._parameters, self._held
        if start_anew:
            anew.fill({})
        else:
            safe = {key: anew.as_started(key, values) for key, values in safe.items()}
        wanted = {k: {**held.get(k, {}), **safe.get(k, {})} for k in self._study.nodes}
        if not at_once:
            self._client.approach.as_far_as_possible(wanted, PARK_TIMEOUT)
        due = anew.due(wanted) if start_anew else []
        failed: dict[str, Exception] = {**parameters.park(safe, held, PARK_TIMEOUT, later=due)}
        if due:
            if self._procedure is not None:
                # What stops the machine does not wait until a node has started.
                self._procedure.publish_stop()
            failed |= anew.bring_each(wanted, due)
            # What others have changed meanwhile does not matter any more.
            parameters.disturbance()
        return [
            f"{self._study.nodes[key].node} is not parked: {why}" for key, why in failed.items()
        ]
