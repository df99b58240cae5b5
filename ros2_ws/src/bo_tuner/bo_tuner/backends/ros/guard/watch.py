"""Decides when a guard acts; knows neither ROS nor clocks."""

from dataclasses import dataclass

from bo_tuner.backends.ros.guard.messages import END, PERIOD, RUN, Beat
from bo_tuner.backends.ros.guard.plan import PATIENCE, Patience

FORGETTING = 1.0 / 60.0
"""By how much [s] the largest delay of a heartbeat counts less in each second that follows it."""
CYCLE = 0.1
"""Time [s] that the tuner has to act on a condition: it checks it every 0.01 s."""


@dataclass(frozen=True)
class Cause:
    """Why a guard acts.

    Attributes
    ----------
    reason : str
        In words.
    takes_over : bool
        Whether the tuner was not in control of the machine. It was if only the guard, or a node,
        was away for a while.
    on_condition : bool
        Whether the abort condition is why: a tuner that aborts the run, too, was only slower.
    """

    reason: str
    takes_over: bool = True
    on_condition: bool = False


class Watch:
    """Watches the tuner by its heartbeats, and the machine by what the guard hears of it.

    It watches from the first beat to the one that says that no further one comes. Times [s] are of
    a steady clock, and given by the caller. On a busy computer beats come late: it waits longer by
    the largest delay that it has seen lately.
    """

    def __init__(self, patience: Patience) -> None:
        self._patience = patience
        self._late = 0.0
        self._last: Beat | None = None
        self._heard = 0.0
        self._gone = False
        self._held_since: float | None = None
        self._away: set[str] = set()
        self._back: list[str] = []
        self._answered = 0
        self.acts = 0

    @property
    def timeout(self) -> float:
        """Time [s] without a beat after which it acts, as things are."""
        return min(self._patience.least + self._late, self._patience.most)

    @property
    def is_watching(self) -> bool:
        """Whether a tuner is at work."""
        return self._last is not None

    @property
    def in_run(self) -> bool:
        """Whether the abort condition counts."""
        return self._last is not None and self._last.phase == RUN

    @property
    def is_known(self) -> bool:
        """Whether the tuner knows of the last act, so that it is in control again."""
        return self._answered == self.acts

    def beat(self, beat: Beat, now: float) -> None:
        """Take a heartbeat."""
        if self._last is None or (beat.phase, beat.run) != (self._last.phase, self._last.run):
            self._held_since = None
        self._answered = beat.acts
        if self._last is not None:
            gap = now - self._heard
            self._late = max(gap - PERIOD, self._late - FORGETTING * gap, 0.0)
        self._heard = now
        self._last = None if beat.phase == END else beat
        if self._last is None:
            self._answered = self.acts

    def hang_up(self) -> None:
        """Take note that the tuner's process has ended."""
        self._gone = True

    def wake(self, now: float) -> None:
        """Take note that this process itself did not run for a while: beats may be waiting."""
        self._heard = now

    def held(self, now: float) -> None:
        """Take note that the abort condition holds."""
        if self.in_run and self._held_since is None:
            self._held_since = now

    def presence(self, node: str, is_there: bool) -> None:
        """Take note of whether a node can be reached."""
        if not self.is_watching:
            return
        if not is_there:
            self._away.add(node)
        elif node in self._away:
            self._away.discard(node)
            self._back.append(node)

    def due(self, now: float) -> Cause | None:
        """Return why to act now, if there is a reason; asked again and again."""
        if self._last is None:
            return None
        if self._gone:
            return Cause("the tuner has ended without leaving the machine safe")
        if not self.is_known:
            # It is held safe until the tuner knows.
            return None
        if now - self._heard > self.timeout:
            return Cause(
                f"no heartbeat of the tuner for {now - self._heard:.2f} s (on a busy computer set "
                f"{PATIENCE} to more [s])"
            )
        if self._held_since is not None and now - self._held_since > CYCLE:
            return Cause(
                "the abort condition holds, and the tuner has not ended the run", on_condition=True
            )
        if self._back:
            nodes, self._back = " and ".join(self._back), []
            return Cause(f"{nodes} could not be reached for a while", takes_over=False)
        return None

    def act(self) -> None:
        """Take note that the guard acts."""
        self.acts += 1
        self._held_since = None
        self._back.clear()
        if self._gone:
            self._last = None
            self._answered = self.acts
