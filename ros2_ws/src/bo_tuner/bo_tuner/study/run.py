"""One run of a system that knows nothing of the tuner, as a procedure."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from bo_tuner.errors import KeyPath, StudyError
from bo_tuner.study import checks, maxima
from bo_tuner.study.signals import GRAPH_NAME, MESSAGE_TYPE, expression

PHASES = ("before", "start", "after")


@dataclass(frozen=True, kw_only=True)
class Publish:
    """A `message` for a `topic`: its fields by name; those that are left out are zero.

    A header without a stamp gets the present time. The message's `type` is that of the topic's
    subscribers unless given.
    """

    topic: str
    message: Mapping[str, object] = field(default_factory=dict)
    type: str = ""

    def __post_init__(self) -> None:
        """Check the fields."""
        checks.matching(self.topic, GRAPH_NAME, "a topic name such as /setpoint", "topic")
        _check_message(self.message, "message")
        if self.type != "":
            checks.matching(
                self.type, MESSAGE_TYPE, "a message type such as std_msgs/msg/Float64", "type"
            )


@dataclass(frozen=True, kw_only=True)
class Call:
    """A call of a `service` with the fields of its `request`, of any type that is installed.

    An answer that has a field `success` must have it true.
    """

    service: str
    request: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the fields."""
        checks.matching(self.service, GRAPH_NAME, "a service name such as /motor/reset", "service")
        _check_message(self.request, "request")


@dataclass(frozen=True, kw_only=True)
class Step:
    """One step of a procedure: `call` a service, `publish` a message, or `wait` [s]."""

    call: Call | None = None
    publish: Publish | None = None
    wait: float | None = None

    def __post_init__(self) -> None:
        """Check the fields."""
        if sum(item is not None for item in (self.call, self.publish, self.wait)) != 1:
            raise StudyError("expected one of call, publish and wait")
        if self.wait is not None:
            object.__setattr__(self, "wait", checks.timeout(self.wait, "wait"))


@dataclass(frozen=True, kw_only=True)
class End:
    """What ends a run: `after` a time since its start [s], or `when` a condition holds."""

    after: float | None = None
    when: str = ""

    def __post_init__(self) -> None:
        """Check the fields."""
        if (self.after is None) == (self.when == ""):
            raise StudyError("expected either after or when")
        if self.after is not None:
            object.__setattr__(self, "after", checks.positive(self.after, "after"))
        checks.text(self.when, "when")


@dataclass(frozen=True, kw_only=True)
class Run:
    """What makes up a run.

    Attributes
    ----------
    end : End
        What ends it.
    before : tuple of Step
        Brings the system to where each run starts.
    start : tuple of Step
        The run's own steps; signals are recorded from here on, and time counts from 0. With `wait`
        between them they are a sequence in time.
    after : tuple of Step
        What follows, also after a run that failed.
    timeout : float
        Longest time [s] of a run from its start to its end.
    abort_when : str
        Condition on signals at which a run ends at once, as failed.
    """

    end: End
    before: tuple[Step, ...] = ()
    start: tuple[Step, ...] = ()
    after: tuple[Step, ...] = ()
    timeout: float = 30.0
    abort_when: str = ""

    def __post_init__(self) -> None:
        """Check the fields."""
        object.__setattr__(self, "timeout", checks.timeout(self.timeout, "timeout"))
        for phase in PHASES:
            checks.at_most(getattr(self, phase), maxima.STEPS, phase)
        checks.text(self.abort_when, "abort_when")
        starting = sum(step.wait or 0.0 for step in self.start)
        if self.end.after is not None:
            if self.end.after > self.timeout:
                raise StudyError(
                    f"{self.end.after:g} s are more than the timeout, {self.timeout:g} s",
                    ("end", "after"),
                )
            if starting > self.end.after:
                raise StudyError(
                    f"the steps take {starting:g} s, but the run ends after {self.end.after:g} s",
                    ("start",),
                )
        if starting > self.timeout:
            raise StudyError(
                f"the steps take {starting:g} s, more than the timeout, {self.timeout:g} s",
                ("start",),
            )

    @property
    def steps(self) -> Iterator[tuple[KeyPath, Step]]:
        """All steps, each with its key path in the study."""
        for phase in PHASES:
            for index, step in enumerate(getattr(self, phase)):
                yield ("run", phase, index), step

    def check_signals(self, signals: Iterable[str]) -> None:
        """Refuse conditions with signals that the study does not have."""
        names = tuple(signals)
        if self.end.when:
            expression(self.end.when, names, "end", "when")
        if self.abort_when:
            expression(self.abort_when, names, "abort_when")


def _check_message(value: object, *path: str | int) -> None:
    """Refuse what no message can hold."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            checks.text(key, *path)
            if not isinstance(item, (bool, int, float, str)):
                _check_message(item, *path, key)
    elif isinstance(value, (list, tuple)) and len(path) > 1:
        for index, item in enumerate(value):
            if not isinstance(item, (bool, int, float, str)):
                _check_message(item, *path, index)
    else:
        raise StudyError(f"expected the fields of a message, found {checks.show(value)}", path)
