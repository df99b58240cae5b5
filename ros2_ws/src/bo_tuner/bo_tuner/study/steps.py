"""The steps of a run on a system that knows nothing of the tuner."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from bo_tuner.codec import checks
from bo_tuner.codec.findings import under
from bo_tuner.codec.reading import Section
from bo_tuner.codec.rules import SECONDS, Expected, Matching, OneOf, RosValue, Within
from bo_tuner.errors import StudyError
from bo_tuner.study.fields import field_path
from bo_tuner.study.playing import Play
from bo_tuner.study.publishing import Message, Publish
from bo_tuner.study.signals import GRAPH_NAME

TRANSITIONS = ("configure", "activate", "deactivate", "cleanup", "shutdown")


@dataclass(frozen=True, kw_only=True)
class Call(Section):
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

    service: Annotated[str, Matching(GRAPH_NAME, "a service name such as /motor/reset")]
    request: Message = field(default_factory=dict)
    expect: Mapping[str, bool | int | float | str] = field(default_factory=dict)
    timeout: Annotated[float, SECONDS] = 5.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.expect:
            with under("expect", name):
                field_path(name)


@dataclass(frozen=True, kw_only=True)
class SendGoal(Section):
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

    action: Annotated[str, Matching(GRAPH_NAME, "an action name such as /follow_path")]
    goal: Message = field(default_factory=dict)
    timeout: Annotated[float, SECONDS] = 30.0


@dataclass(frozen=True, kw_only=True)
class Lifecycle(Section):
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

    node: Annotated[str, Matching(GRAPH_NAME, "a node name such as /camera")]
    transition: Annotated[str, OneOf(TRANSITIONS)]
    timeout: Annotated[float, SECONDS] = 5.0


@dataclass(frozen=True, kw_only=True)
class SetParameter(Section):
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
    parameter: Annotated[str, checks.parameter_name]
    value: RosValue


@dataclass(frozen=True, kw_only=True)
class WaitUntil(Section):
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
    hold: Annotated[float, Within(least=0.0, unit="s")] = 0.1
    timeout: Annotated[float, SECONDS] = 10.0
    rising: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.hold > self.timeout:
            raise StudyError(
                f"{self.hold:g} s are more than the timeout, {self.timeout:g} s", ("hold",)
            )


_KINDS = ("call", "publish", "send_goal", "lifecycle", "set", "wait_until", "play")


@dataclass(frozen=True, kw_only=True)
class Step(Section):
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
    play : Play, optional
        Plays a bag to the nodes.
    wait : float, optional
        Waits for a time [s].
    """

    call: Call | None = None
    publish: Publish | None = None
    stop: Annotated[str, Matching(GRAPH_NAME, "a topic name such as /setpoint")] = ""
    send_goal: SendGoal | None = None
    lifecycle: Lifecycle | None = None
    set: SetParameter | None = None
    restart: Annotated[str | tuple[str, ...], Expected("a node, or a list of nodes")] = ""
    wait_until: WaitUntil | None = None
    play: Play | None = None
    wait: Annotated[float, SECONDS] | None = None

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
        super().__post_init__()
        if self.restart == ():
            raise StudyError("expected a node, or a list of nodes", ("restart",))
        given = [key for key in (*_KINDS, "wait") if getattr(self, key) is not None]
        if len(given) + bool(self.restart) + bool(self.stop) != 1:
            raise StudyError(f"expected one of {', '.join((*_KINDS, 'restart', 'stop'))} and wait")


Steps = Annotated[tuple[Step, ...], Expected("a list of steps")]
