"""What a study records of a system's topics, and expressions of it."""

import keyword
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated

from bo_tuner.codec import checks
from bo_tuner.codec.reading import Section
from bo_tuner.codec.rules import KEY, POSITIVE, Expected, Matching, OneOf, Whole
from bo_tuner.errors import StudyError
from bo_tuner.numerics.expressions import (
    FUNCTIONS,
    Expression,
    ExpressionError,
    UnknownNameError,
)
from bo_tuner.study.fields import parsed_field

HEADER, RECEPTION = "header", "reception"
TIME = "t"
"""Name, in an expression, of the time since the start of the run [s]."""

SIGNAL_NAME = re.compile(r"[A-Za-z_]\w{0,63}", re.ASCII)
GRAPH_NAME = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
Frame = Annotated[str, Matching(re.compile(r"[^\s/][^\s]*"), "a frame such as map")]
TF = "/tf"
"""Topic of transforms; transforms that never change are on this name with `STATIC` appended."""
STATIC = "_static"
MESSAGE_TYPE = re.compile(r"[a-z]\w*/msg/[A-Z]\w*", re.ASCII)
OF_MESSAGES = "a message type such as std_msgs/msg/Float64"


@dataclass(frozen=True, kw_only=True)
class Signal(Section):
    """What a study records over the time of a run: a number in messages, or whole messages.

    Attributes
    ----------
    name : str
        Name in the study and in expressions.
    topic : str
        The topic, relative to the tuner's namespace or absolute; `/tf` of `frames` unless given.
    field : str
        Path of the field, such as `data`, `pose.pose.position.x`, `data[3]`, or `position[motor]`
        for the joint `motor` of a JointState; or a number that is computed of fields, such as
        `min(ranges)` or `yaw(pose.pose.orientation)`. Without it the signal is the whole messages,
        for Python functions and plans.
    frames : pair of str, optional
        Two frames, as `[map, base_link]`: the signal is of where the second one is in the first,
        and `field` is one of a Transform, such as `translation.x` or `yaw(rotation)`.
    publisher : str
        The node that messages are taken from where several publish the topic.
    merge : bool
        Whether the messages of all publishers count, where there are several.
    type : str
        Type of the messages, such as `std_msgs/msg/Float64`; what the publisher says unless given.
    time : str
        `header`, the stamp in the message's header, or `reception`, when it came in by the clock
        of the run; `header` if the message has one, unless given.
    minimum_messages : int
        A run with fewer messages fails.
    largest_gap : float, optional
        A run fails if no message comes for longer than this [s], also after its start or before
        its end; unless given, if none comes for much longer than in the first runs.
    most_lost : int, optional
        A run fails if more messages than this are lost or late.
    """

    name: Annotated[str, KEY, Matching(SIGNAL_NAME, "a name of letters, digits and _")]
    topic: Annotated[str, Matching(GRAPH_NAME, "a topic name such as /joint_states")] = ""
    field: str = ""
    frames: (
        Annotated[tuple[Frame, Frame], Expected("[frame, other], as [map, base_link]")] | None
    ) = None
    publisher: Annotated[str, Matching(GRAPH_NAME, "a node name such as /arm")] = ""
    merge: bool = False
    type: Annotated[str, Matching(MESSAGE_TYPE, OF_MESSAGES)] = ""
    time: Annotated[str, OneOf((HEADER, RECEPTION))] = ""
    minimum_messages: Annotated[int, Whole(0)] = 1
    largest_gap: Annotated[float, POSITIVE] | None = None
    most_lost: Annotated[int, Whole(0)] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.name == TIME or self.name in FUNCTIONS or keyword.iskeyword(self.name):
            raise StudyError(f"'{self.name}' has a meaning in expressions; choose another name")
        self._check_frames()
        if self.topic == "":
            raise StudyError("missing", ("topic",))
        if self.field:
            parsed_field(self.field)
        if self.publisher and (self.merge or self.frames is not None):
            beside = "merge" if self.merge else "frames"
            raise StudyError(
                f"messages of one node or of all; leave out publisher or {beside}",
                ("publisher",),
            )

    def _check_frames(self) -> None:
        if self.frames is None:
            return
        if self.frames[0] == self.frames[1]:
            raise StudyError(f"expected two frames, found '{self.frames[0]}' twice", ("frames",))
        if self.topic == "":
            object.__setattr__(self, "topic", TF)
        if self.field == "":
            raise StudyError(
                "missing; expected a field of a transform such as translation.x or yaw(rotation)",
                ("field",),
            )

    @property
    def is_number(self) -> bool:
        """Whether it has numbers, and not whole messages."""
        return self.field != ""

    @property
    def has_several(self) -> bool:
        """Whether its topic may have publishers of several nodes."""
        return self.merge or self.publisher != "" or self.frames is not None

    @property
    def source(self) -> str:
        """Where it comes from, in a few words: its topic, and its frames if it has any."""
        return " ".join([self.topic, *([] if self.frames is None else self.frames)])


def only_numbers(text: str, signals: Mapping[str, Signal], *path: str | int) -> None:
    """Refuse an expression of signals that are whole messages.

    Raises
    ------
    StudyError
        If it has one.
    """
    for name in sorted(expression(text, signals, *path).names - {TIME}):
        if not signals[name].is_number:
            raise StudyError(
                f"signal {name} has no field: it is whole messages, and no number to compute with",
                path,
            )


def expression(text: object, signals: Iterable[str], *path: str | int) -> Expression:
    """Return the expression that a text is.

    Raises
    ------
    StudyError
        If it is none, or has other names than signals and `TIME`.
    """
    return named_expression(text, (*signals, TIME), "signal", *path)


def named_expression(
    text: object, names: tuple[str, ...], kind: str, *path: str | int, finite: bool = False
) -> Expression:
    """Return the expression of `names` that a text is; `kind` says in errors what they name.

    With `finite` a comparison with an infinite number is not known, like one with NaN.

    Raises
    ------
    StudyError
        If it is none, or has other names.
    """
    try:
        return Expression(checks.text(text, *path), names, finite=finite)
    except UnknownNameError as error:
        hint = checks.suggestion(error.name, error.known)
        raise StudyError(f"there is no {kind} or function '{error.name}'; {hint}", path) from None
    except ExpressionError as error:
        problem = f"{error}, in {checks.quoted(str(text))}"
        raise StudyError(problem, path) from None
