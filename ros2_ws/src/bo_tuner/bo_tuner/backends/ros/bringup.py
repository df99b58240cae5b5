"""Brings the nodes of a study up: started or attached to, discovered, restarted when lost."""

import os
import time
from collections.abc import Sequence

from bo_tuner.backends.layers.suspension import Suspension
from bo_tuner.backends.ros.errors import LostError, RefusedError
from bo_tuner.backends.ros.isolation import LEASE
from bo_tuner.backends.ros.parameters.at_rest import InitialParameters
from bo_tuner.backends.ros.parameters.events import Values
from bo_tuner.backends.ros.started_nodes import StartedNodes
from bo_tuner.backends.ros.study_client import StudyClient
from bo_tuner.backends.ros.tuner_node import END_OTHERS, TunerNode
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.study.study import Study

ATTACH_TIMEOUT = 5.0
LOOK_AROUND = 1.0
"""Time [s] to discover nodes, or another tuner, that run already."""


class Bringup:
    """Brings the nodes of a study up."""

    def __init__(
        self,
        study: Study,
        tuner: TunerNode,
        client: StudyClient,
        started: StartedNodes,
        suspension: Suspension,
        *,
        attach: bool,
    ) -> None:
        self._study = study
        self._tuner = tuner
        self._client = client
        self._started = started
        self._suspension = suspension
        self._attach = attach
        client.start_values.restart = self.restart

    def open(self, safe: Values, *, look_around: bool) -> None:
        """Start the nodes, unless attached, wait for them, and refuse to share them."""
        tuner, presence = self._tuner, self._client.presence
        self._client.start_values.reset(safe)
        if not self._attach:
            if look_around:
                self._refuse_running()
            self._started.start()
        self._wait_for_nodes(ATTACH_TIMEOUT if self._attach else None)
        if self._attach:
            # That the nodes are discovered does not mean that another tuner is, too.
            tuner.spin_for(LOOK_AROUND)
        tuner.refuse_other_tuner()
        if twins := presence.twins(LEASE):
            raise BackendError(f"{twins}; {END_OTHERS}")
        self._settle_all()

    def restart(self, keys: Sequence[str]) -> None:
        """Restart nodes that the tuner has started, and set the parameters that they must have."""
        presence = self._client.presence
        self._suspension.look()
        for key in keys:
            self._started.stop_one(key)
        self._suspension.skip()
        started_by = self._client.start_values.started_by
        ended = {*keys, *(other for key in keys for other in started_by(key))}
        self._tuner.wait_until(lambda: ended <= set(presence.absent()), LEASE)
        self._client.start_values.between(())
        for key in keys:
            try:
                self._started.start_one(key)
            except (BackendError, StudyError) as error:
                raise LostError(f"{key} is not started anew: {error}") from error
        # Others may run in the same process.
        for anew in dict.fromkeys((*keys, *self._wait_for_nodes())):
            self._client.assign_again(anew)
        self._client.start_values.after()

    def get_back(self) -> None:
        """Start all nodes anew after a loss, or, attached, wait for them; set their constants."""
        tuner, client = self._tuner, self._client
        client.parameters.forget_all()
        if self._attach:
            if missing := client.presence.missing():
                names = " and ".join(self._study.nodes[key].node for key in missing)
                longest = max(self._study.nodes[key].start_timeout for key in missing)
                tuner.warn(f"a test run was lost: waiting up to {longest:g} s for {names}")
        else:
            self._suspension.look()
            self._started.stop()
            self._suspension.skip()
            client.presence.wait_until_gone(LEASE)
            self._client.start_values.between(())
            client.start_values.reset()
            self._started.start()
        anew = self._wait_for_nodes()
        if self._attach:
            # A node that was killed and is back appears in the graph bit by bit.
            tuner.spin_for(LOOK_AROUND)
            anew += client.restarted()
        client.renew(anew)
        self._settle_all()
        InitialParameters(self._study, tuner, client.parameters).set_constants()

    def _wait_for_nodes(self, timeout: float | None = None) -> list[str]:
        """Wait for all nodes; if one does not come, say what its program has printed."""
        presence, nodes = self._client.presence, self._study.nodes
        begun = time.monotonic()
        try:
            return presence.wait_for_nodes(
                {k: timeout or spec.start_timeout for k, spec in nodes.items()}
            )
        except LostError as loss:
            running = self._started.processes
            if any(item.exit_reason is not None for item in running.values()):
                # That is what it says already.
                raise
            absent = [key for key in presence.absent() if key in running]
            said = [f"{running[k].name} runs, {running[k].said}" for k in absent or running]
            waited = [
                f"it had {nodes[key].start_timeout:g} s (nodes.{key}.start_timeout)"
                for key in absent
                if time.monotonic() > begun + nodes[key].start_timeout
            ]
            raise LostError("; ".join([str(loss), *waited, *said])) from loss

    def _settle_all(self) -> None:
        try:
            self._client.start_values.settle_all()
        except RefusedError as refusal:
            raise BackendError(str(refusal)) from refusal

    def _refuse_running(self) -> None:
        self._tuner.spin_for(LOOK_AROUND)
        absent = self._client.presence.absent()
        running = [spec.node for key, spec in self._study.nodes.items() if key not in absent]
        if running:
            raise BackendError(
                f"{running[0]}: is already running in ROS domain {os.environ['ROS_DOMAIN_ID']}; "
                "use --attach, or leave ROS_DOMAIN_ID unset"
            )
