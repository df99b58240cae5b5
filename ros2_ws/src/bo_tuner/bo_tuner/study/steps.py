"""The steps of a run on a system that knows nothing of the tuner."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from bo_tuner.codec import checks
from bo_tuner.codec.reading import Findings, arguments, build, under
from bo_tuner.errors import StudyError
from bo_tuner.study.fields import field_path
from bo_tuner.study.publishing import Publish, build_publish, check_message
from bo_tuner.study.signals import GRAPH_NAME

TRANSITIONS = ("configure", "activate", "deactivate", "cleanup", "shutdown")


@dataclass(frozen=True, kw_only=True)
class Call:
    """A call of a service, which says in its answer whether it was done.

    It was not if one of these is false: `success`, `ok`, `mode_sent`, `status.success`,
    `result.successful`, `results[].successful`; or if a code in `return_code`, `result.result` or
    `error_code.val` is not that of a success.

    Attributes
    ----------
    service : str
        Service, of any type that is installed.
    request : mapping
        Fields of the request by name; those that are left out are zero.
    expect : mapping
        Values by field, such as `{status.code: 0}`, that the answer must have, where other fields
        than those above tell it, or these tell something else; of an array each item.
    timeout : float
        Longest time [s] until the answer.
    """

    service: str
    request: Mapping[str, object] = field(default_factory=dict)
    expect: Mapping[str, bool | int | float | str] = field(default_factory=dict)
    timeout: float = 5.0

    def __post_init__(self) -> None:
        checks.matching(self.service, GRAPH_NAME, "a service name such as /motor/reset", "service")
        check_message(self.request, "request")
        check_message(self.expect, "expect")
        for name, value in self.expect.items():
            with under("expect", name):
                field_path(name)
                if not isinstance(value, (bool, int, float, str)):
                    raise StudyError(f"expected a single value, found {checks.show(value)}")
        object.__setattr__(self, "timeout", checks.timeout(self.timeout, "timeout"))


@dataclass(frozen=True, kw_only=True)
class SendGoal:
    """A goal for an action server.

    In `start` the run goes on while the goal is executed, and the goal is cancelled when the run
    ends before it; elsewhere the step waits for its result.

    Attributes
    ----------
    action : str
        Action, of any type that is installed.
    goal : mapping
        Fields of the goal by name; those that are left out are zero.
    timeout : float
        Longest time [s] that a step outside of `start` waits for the result.
    """

    action: str
    goal: Mapping[str, object] = field(default_factory=dict)
    timeout: float = 30.0

    def __post_init__(self) -> None:
        checks.matching(self.action, GRAPH_NAME, "an action name such as /follow_path", "action")
        check_message(self.goal, "goal")
        object.__setattr__(self, "timeout", checks.timeout(self.timeout, "timeout"))


@dataclass(frozen=True, kw_only=True)
class Lifecycle:
    """A transition of a lifecycle node.

    To deactivate a node that is not active, or to clean one up that is not configured, is no
    mistake.

    Attributes
    ----------
    node : str
        ROS name of the node.
    transition : str
        `configure`, `activate`, `deactivate`, `cleanup` or `shutdown`.
    timeout : float
        Longest time [s] of the transition.
    """

    node: str
    transition: str
    timeout: float = 5.0

    def __post_init__(self) -> None:
        checks.matching(self.node, GRAPH_NAME, "a node name such as /camera", "node")
        checks.choice(self.transition, TRANSITIONS, "transition")
        object.__setattr__(self, "timeout", checks.timeout(self.timeout, "timeout"))


@dataclass(frozen=True, kw_only=True)
class SetParameter:
    """A parameter of a node that a step sets: a set-point, a mode, a gain of another controller.

    It has the value from then on, until another step sets it; after a run it has again what it had,
    or what a step of `after` sets, and in the end what it had before the tuner came.

    Attributes
    ----------
    node : str
        The node, by its key in `nodes`.
    parameter : str
        A parameter of it that is neither tuned nor set by a context.
    value : bool, int, float, str or list of these
        The value.
    """

    node: str
    parameter: str
    value: checks.ParameterValue

    def __post_init__(self) -> None:
        checks.text(self.node, "node")
        checks.parameter_name(self.parameter, "parameter")
        try:
            values = checks.parameter_values({self.parameter: self.value})
        except StudyError as error:
            raise StudyError(error.problem, ("value", *error.path[1:])) from None
        object.__setattr__(self, "value", values[self.parameter])


@dataclass(frozen=True, kw_only=True)
class WaitUntil:
    """A wait for a condition on signals, or for the moment at which one comes to hold.

    Attributes
    ----------
    condition : str
        An expression, such as `abs(position) < 0.1`.
    hold : float
        Time [s] for which it must hold without a break; with 0, a single message is enough.
    timeout : float
        Longest time [s] of the wait; a run in which it does not hold until then fails.
    rising : bool
        Whether it must come to hold: it counts only once it has not held since the step began.
    """

    condition: str
    hold: float = 0.1
    timeout: float = 10.0
    rising: bool = False

    def __post_init__(self) -> None:
        checks.text(self.condition, "condition")
        object.__setattr__(self, "timeout", checks.timeout(self.timeout, "timeout"))
        checks.boolean(self.rising, "rising")
        object.__setattr__(self, "hold", checks.number(self.hold, "hold"))
        if self.hold < 0.0:
            raise StudyError(f"expected at least 0 s, found {self.hold:g}", ("hold",))
        if self.hold > self.timeout:
            raise StudyError(
                f"{self.hold:g} s are more than the timeout, {self.timeout:g} s", ("hold",)
            )


_KINDS: dict[str, type[Any]] = {
    "call": Call,
    "publish": Publish,
    "send_goal": SendGoal,
    "lifecycle": Lifecycle,
    "set": SetParameter,
    "wait_until": WaitUntil,
}


@dataclass(frozen=True, kw_only=True)
class Step:
    """One step of a procedure; exactly one field is given.

    Attributes
    ----------
    call : Call, optional
        Calls a service.
    publish : Publish, optional
        Publishes a message, or begins to stream a reference.
    stop : str
        Topic of a stream that ends with this step.
    send_goal : SendGoal, optional
        Sends a goal to an action server.
    lifecycle : Lifecycle, optional
        Changes the state of a lifecycle node.
    set : SetParameter, optional
        Sets a parameter of a node.
    restart : str or tuple of str
        Node of the study, started by the tuner, that is ended and started anew, or several that
        come up together.
    wait_until : WaitUntil, optional
        Waits for a condition on signals.
    wait : float, optional
        Waits for a time [s].
    """

    call: Call | None = None
    publish: Publish | None = None
    stop: str = ""
    send_goal: SendGoal | None = None
    lifecycle: Lifecycle | None = None
    set: SetParameter | None = None
    restart: str | tuple[str, ...] = ""
    wait_until: WaitUntil | None = None
    wait: float | None = None

    @property
    def restarts(self) -> tuple[str, ...]:
        """The nodes that are started anew."""
        if isinstance(self.restart, str):
            return (self.restart,) if self.restart else ()
        return self.restart

    @property
    def waits(self) -> bool:
        """Whether it does nothing but wait."""
        return self.wait is not None or self.wait_until is not None

    def __post_init__(self) -> None:
        if not isinstance(self.restart, str):
            nodes = checks.sequence(self.restart, "a node, or a list of nodes", "restart")
            names = tuple(checks.text(name, "restart", k) for k, name in enumerate(nodes))
            if not names:
                raise StudyError("expected a node, or a list of nodes", ("restart",))
            object.__setattr__(self, "restart", names)
        if self.stop != "":
            checks.matching(self.stop, GRAPH_NAME, "a topic name such as /setpoint", "stop")
        given = [key for key in (*_KINDS, "wait") if getattr(self, key) is not None]
        if len(given) + bool(self.restart) + bool(self.stop) != 1:
            raise StudyError(f"expected one of {', '.join((*_KINDS, 'restart', 'stop'))} and wait")
        if self.wait is not None:
            object.__setattr__(self, "wait", checks.timeout(self.wait, "wait"))


def build_steps(value: object) -> tuple[Step, ...]:
    """Return the steps that a list of a study file describes.

    Raises
    ------
    StudyError
        If it is none, or one of its items is no step.
    """
    steps = []
    findings = Findings()
    for index, step in enumerate(checks.sequence(value, "a list of steps")):
        with findings.under(index):
            steps.append(_build_step(step))
    findings.check()
    return tuple(steps)


def _build_step(value: object) -> Step:
    if isinstance(value, Step):
        return value
    fields = arguments(Step, value)
    for key, cls in _KINDS.items():
        if key in fields:
            with under(key):
                is_publish = cls is Publish
                fields[key] = build_publish(fields[key]) if is_publish else build(cls, fields[key])
    return Step(**fields)
