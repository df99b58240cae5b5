"""The way of nodes to what they are to have next, where the study sets it in small steps."""

import contextlib
import time
from collections.abc import Callable, Collection, Mapping

from bo_tuner.backends.ros.errors import LostError, RefusedError
from bo_tuner.backends.ros.parameters.events import Values
from bo_tuner.backends.ros.parameters.nodes import NodeParameters
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.study.ramping import Ramp
from bo_tuner.study.study import Study


class Approach:
    """Takes nodes all the way but the last step, which sets what they are to have.

    A study without a ramp has none of this. Times are by the machine's clock, in which a
    simulation may pause: it does so between two runs.

    Attributes
    ----------
    announce : callable
        Called with all that nodes are about to be set to, each by node key, ahead of that.
    """

    def __init__(self, study: Study, tuner: TunerNode, parameters: NodeParameters) -> None:
        self._ramp = Ramp(study)
        self._tuner = tuner
        self._parameters = parameters
        self._seconds = 0.0
        self.announce: Callable[..., object] = lambda *values: None

    def to_held(self, wanted: Values, kept: Mapping[str, Collection[str]]) -> None:
        """Bring nodes near what they are to `hold` next; raises what that raises."""

        def assign(step: Values) -> bool:
            try:
                self._parameters.assign_held(step, kept)
            except RefusedError as refusal:
                raise RefusedError(f"{refusal} (in the ramp)") from refusal
            return True

        self._go(wanted, assign)

    def as_far_as_possible(self, wanted: Values, timeout: float) -> None:
        """Bring nodes near what they are to have; one that does not take a step ends the way."""
        # What is lost is told by what follows.
        with contextlib.suppress(LostError):
            self._go(wanted, lambda step: not self._parameters.assign_side_by_side(step, timeout))

    def take_seconds(self) -> float:
        """Return the time [s] that was spent on the way since this was last asked."""
        seconds, self._seconds = self._seconds, 0.0
        return seconds

    def _go(self, wanted: Values, assign: Callable[[Values], bool]) -> None:
        if not self._ramp:
            return
        steps = self._ramp.steps(self._parameters.present(wanted), wanted)
        if not steps:
            return
        begun = time.monotonic()
        try:
            # A tuner that is killed on the way leaves the nodes with one of these.
            self.announce(wanted, *steps)
            for step in steps:
                # After a step that took its time the next one waits all the same: none is larger.
                self._tuner.spin_for(self._ramp.period)
                if not assign(step):
                    return
            self._tuner.spin_for(self._ramp.period)
        finally:
            self._seconds += time.monotonic() - begun
