"""What a study records of a system's topics, and expressions of it."""

import keyword
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from bo_tuner.codec import checks
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
FRAME = re.compile(r"[^\s/][^\s]*")
TF = "/tf"
"""Topic of transforms; transforms that never change are on this name with `STATIC` appended."""
STATIC = "_static"
MESSAGE_TYPE = re.compile(r"[a-z]\w*/msg/[A-Z]\w*", re.ASCII)


@dataclass(frozen=True, kw_only=True)
class Signal:
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

    name: str
    topic: str = ""
    field: str = ""
    frames: tuple[str, str] | None = None
    publisher: str = ""
    merge: bool = False
    type: str = ""
    time: str = ""
    minimum_messages: int = 1
    largest_gap: float | None = None
    most_lost: int | None = None

    def __post_init__(self) -> None:
        checks.matching(self.name, SIGNAL_NAME, "a name of letters, digits and _")
        if self.name == TIME or self.name in FUNCTIONS or keyword.iskeyword(self.name):
            raise StudyError(f"'{self.name}' has a meaning in expressions; choose another name")
        self._check_frames()
        if self.topic == "":
            raise StudyError("missing", ("topic",))
        checks.matching(self.topic, GRAPH_NAME, "a topic name such as /joint_states", "topic")
        if checks.text(self.field, "field"):
            parsed_field(self.field)
        checks.boolean(self.merge, "merge")
        if self.publisher != "":
            checks.matching(self.publisher, GRAPH_NAME, "a node name such as /arm", "publisher")
            if self.merge or self.frames is not None:
                beside = "merge" if self.merge else "frames"
                raise StudyError(
                    f"messages of one node or of all; leave out publisher or {beside}",
                    ("publisher",),
                )
        if self.type != "":
            checks.matching(
                self.type, MESSAGE_TYPE, "a message type such as std_msgs/msg/Float64", "type"
            )
        if self.time != "":
            checks.choice(self.time, (HEADER, RECEPTION), "time")
        checks.integer(self.minimum_messages, "minimum_messages", at_least=0)
        if self.largest_gap is not None:
            gap = checks.positive(self.largest_gap, "largest_gap")
            object.__setattr__(self, "largest_gap", gap)
        if self.most_lost is not None:
            checks.integer(self.most_lost, "most_lost", at_least=0)

    def _check_frames(self) -> None:
        if self.frames is None:
            return
        expected = "[frame, other], as [map, base_link]"
        one, other = checks.pair(self.frames, expected, "frames")
        pair = tuple(
            checks.matching(frame, FRAME, "a frame such as map", "frames", index)
            for index, frame in enumerate((one, other))
        )
        object.__setattr__(self, "frames", pair)
        if pair[0] == pair[1]:
            raise StudyError(f"expected two frames, found '{pair[0]}' twice", ("frames",))
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
