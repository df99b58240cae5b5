"""Time in which this process did not run: stopped by SIGSTOP, or the lid of a laptop closed."""

import time
from collections.abc import Callable

from bo_tuner.backends.layers.layer import Layer, Run
from bo_tuner.trials import Evaluation, EvaluationState, Outcome

LONGEST = 5.0
"""Gap [s] between two checks beyond which this process was suspended: it checks every 0.1 s
while it waits, and takes less to handle what came."""
ATTEMPTS = 3
"""Times that an evaluation is run during which this process is suspended, until it is lost."""


def _now() -> float:
    """Return a steady time [s] that goes on while the machine sleeps."""
    # Elsewhere than on Linux there is no such clock; the steady one shows SIGSTOP at least.
    return time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))


class Suspension:
    """The longest gap between two readings of the clock."""

    def __init__(self, clock: Callable[[], float] = _now) -> None:
        self._clock = clock
        self.begin()

    def begin(self) -> None:
        """Begin anew; what was before does not count."""
        self._last = self._clock()
        self._longest = 0.0

    def look(self) -> None:
        """Read the clock."""
        now = self._clock()
        self._longest = max(self._longest, now - self._last)
        self._last = now

    def skip(self) -> None:
        """Leave out the time since the last reading, in which this process waited without one."""
        self._last = self._clock()

    @property
    def seconds(self) -> float:
        """How long this process was suspended [s]; 0 if it was not."""
        return self._longest if self._longest > LONGEST else 0.0

    @property
    def longest(self) -> float:
        """The longest gap between two readings [s]; this process may have computed in it, too."""
        return self._longest


def not_suspended(
    suspension: Suspension, look: Callable[[], None], settled: Callable[[], bool]
) -> Layer:
    """Repeat a run in which this process was suspended: it says nothing of the parameters.

    Parameters
    ----------
    suspension
        What has looked during the run, and is begun anew for each.
    look
        Called ahead of each run; raises what is to end them all.
    settled
        Whether a run that was suspended is not to be repeated all the same.
    """

    def layer(run: Run) -> Run:
        def awake(planned: Evaluation) -> Outcome:
            for _ in range(ATTEMPTS):
                # A request to end that came during the proposal, or while the tuner was suspended:
                # no node is to get these parameters.
                look()
                suspension.begin()
                outcome = run(planned)
                suspension.look()
                seconds = suspension.seconds
                if not seconds or settled():
                    return outcome
            lost = f"the tuner was suspended for {seconds:.0f} s"
            return Outcome(EvaluationState.LOST, {}, lost)

        return awake

    return layer
