"""The run of a first study: what moves the system, and how it comes back to rest."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from bo_tuner.study.offers import CHECK, REFERENCE
from bo_tuner.study.seen import Seen, SeenAction, SeenTopic
from bo_tuner.study.signal_offers import TRUTH, SignalOffer, is_sure, signal_offers
from bo_tuner.study.strict_yaml import dump_line

SECONDS = 2.0
"""Time [s] of a run, until the user gives a better one."""
STEP = 1.0
"""Step of a reference, in its unit, until the user gives a better one."""
JOINT_STEP, SPEED_STEP = 0.1, 0.2
"""Step of a trajectory [rad], and of a `Twist` [m/s or rad/s]: small for most machines."""
SETTLED, LEAST_SETTLED = 0.02, 0.01
"""Share of the step within which the system has settled; least value, in the unit of the signal."""
TRAJECTORY_SECONDS = 1
"""Time [s] that a trajectory takes."""
POSE = re.compile(r"(position|orientation)\.[xyzw]$")
"""Fields of a pose."""
START = re.compile(r"(^|_)(go|start|run|begin|launch|trigger|execute)(_|$)", re.IGNORECASE)
"""Words in the name of a service that sets a system in motion."""
MOST_INPUTS = 3
"""Topics that are offered for a start where none is known."""


@dataclass(frozen=True)
class Step:
    """A step of the reference, where the run is to publish it.

    Attributes
    ----------
    wanted
        The reference.
    rest
        Its value before the start and after the end.
    size
        What the start adds.
    beside
        Values of other fields of the message, which stay as they are.
    is_known
        Whether the system is known to be at rest there.
    """

    wanted: SignalOffer
    rest: float
    size: float
    beside: Mapping[str, float] = field(default_factory=dict, hash=False)
    is_known: bool = True

    @property
    def back(self) -> dict[str, Any]:
        """Topic and message that bring the system to rest."""
        return published(self.wanted, self.rest, self.beside)

    @property
    def forth(self) -> dict[str, Any]:
        """Topic and message that start a run."""
        return published(self.wanted, round(self.rest + self.size, 3), self.beside)


def step_of(wanted: SignalOffer | None, measured: SignalOffer | None) -> Step | None:
    """Return the step of a run; None where nothing is to be followed, or others publish it.

    It begins where the system is now, if that is known: a position of 0 may be far away.
    """
    if wanted is None or wanted.topic.publishers:
        return None
    size = STEP
    if wanted.topic.joints:
        size = JOINT_STEP
    elif wanted.field.endswith(("linear.x", "angular.z")):
        size = SPEED_STEP
    if wanted.topic.joints:
        return Step(wanted, round(wanted.value, 2) + 0.0, size)
    if measured is None or measured.topic.is_silent or not is_sure(wanted, measured):
        return Step(wanted, 0.0, size, is_known=False)
    # A speed or an effort of 0 is rest; a position is kept where it is.
    is_place = measured.quantity not in ("velocity", "effort")
    rest = measured.value if is_place else 0.0
    return Step(wanted, round(rest, 2) + 0.0, size, _beside(wanted, measured))


def _beside(wanted: SignalOffer, measured: SignalOffer) -> dict[str, float]:
    """Return where a pose is now, by the fields of its reference."""
    now = {_tail(name): value for name, value in measured.topic.fields.items() if POSE.search(name)}
    return {
        name: round(float(now[_tail(name)]), 3) + 0.0
        for name in wanted.topic.fields
        if name != wanted.field and _tail(name) in now
    }


def _tail(name: str) -> str:
    return ".".join(name.split(".")[-2:])


def run_lines(
    seen: Seen,
    names: Mapping[SignalOffer, str],
    wanted: SignalOffer | None,
    measured: SignalOffer | None,
    references: Sequence[tuple[str, str, float]],
    *,
    is_simulated: bool,
) -> Iterator[str]:
    """Yield the lines of ``run``.

    Parameters
    ----------
    seen
        All that runs.
    names
        The signals of the study, and their names in it.
    wanted, measured
        The reference, and what shall follow it.
    references
        Key of a node, name and value of the parameters that are its reference by their names.
    is_simulated
        Whether the nodes are in simulated time.
    """
    step = step_of(wanted, measured)
    yield "run:"
    yield from _before_lines(seen, names, step, measured)
    yield from _start_lines(seen, step, references)
    until = ", or result: until a goal of start is done" if seen.actions else ""
    yield f"  end: {{after: {SECONDS}}}  # {CHECK}: [s]{until}"
    if step is not None:
        yield "  after:  # after every run, also a failed one"
        yield f"    - publish: {dump_line(step.back)}"
    if is_simulated:
        yield f"  clock: sim  # {CHECK}: the nodes use simulated time; its seconds are those of end"
    if measured is not None:
        most = 2 * (STEP if step is None else step.size)
        deviation = _deviation(names[measured], 0.0 if step is None else step.rest)
        yield f"  # abort_when: {deviation} > {most:g}  # ends a bad run at once"


def _before_lines(
    seen: Seen,
    names: Mapping[SignalOffer, str],
    step: Step | None,
    measured: SignalOffer | None,
) -> Iterator[str]:
    """Yield what brings the system to rest: messages, services as offers, and a wait."""
    own = {offer.topic.name: offer for offer in names if not offer.topic.publishers}
    messages = [
        published(offer, round(offer.value, 2) if offer.topic.joints else 0.0)
        for offer in own.values()
    ]
    if step is not None:
        name = step.wanted.topic.name
        messages = [step.back if m["topic"] == name else m for m in messages]
    yield f"  # {CHECK}: what brings the system to where every run starts."
    # If no message brings the system to rest, all lines are offers, in comments.
    mark, margin = ("  ", "    ") if messages else ("  # ", "  #   ")
    offered = "    # " if messages else margin
    yield f"{mark}before:"
    for message in messages:
        remark = ""
        if step is not None and message == step.back and not step.is_known:
            remark = f"  # {CHECK}: where it is now is not known"
        elif step is not None and message == step.back and step.rest != 0.0:
            remark = "  # where it is now"
        yield f"{margin}- publish: {dump_line(message)}{remark}"
    for service in seen.services:
        if not is_start(service):
            yield f"{offered}- call: {dump_line({'service': service})}"
    if step is None or measured is None or not step.is_known or measured.topic.is_silent:
        settled = {"condition": "abs(SPEED) < 0.01", "hold": 0.5}
        yield f"{offered}- wait_until: {dump_line(settled)}  # {CHECK}: at rest"
        return
    most = max(SETTLED * step.size, LEAST_SETTLED)
    settled = {
        "condition": f"{_deviation(names[measured], step.rest)} < {most:g}",
        "hold": 0.5,
        "timeout": 10.0,
    }
    yield f"{margin}- wait_until: {dump_line(settled)}  # {CHECK}: at rest"


def is_start(service: str) -> bool:
    """Whether a service sets a system in motion, by its name."""
    return START.search(service.rpartition("/")[2]) is not None


def _start_lines(
    seen: Seen, step: Step | None, references: Sequence[tuple[str, str, float]]
) -> Iterator[str]:
    offers = [
        f"- set: {dump_line({'node': key, 'parameter': name, 'value': round(value + STEP, 6)})}"
        for key, name, value in references
    ]
    calls = offers + [f"- call: {dump_line({'service': s})}" for s in seen.services if is_start(s)]
    if step is not None:
        stamped = "; its header needs a frame" if "Stamped" in step.wanted.topic.type else ""
        yield f"  # {known(step.wanted.topic)}"
        yield f"  start:  # {CHECK}: this moves the machine, by a step of {step.size:g}{stamped}"
        yield f"    - publish: {dump_line(step.forth)}"
        if "Twist" in step.wanted.topic.type:
            yield f"    # {CHECK}: it is published once; many drives stop without more of them."
        yield from (f"    # {line}" for line in (*calls, *_goals(seen.actions)))
        return
    if len(calls) == 1 and not offers:
        yield f"  start:  # {CHECK}: by its name this sets it in motion"
        yield f"    {calls[0]}"
        yield from (f"    # {line}" for line in _goals(seen.actions))
        return
    yield f"  # {CHECK}: what sets it in motion; without it a run only watches."
    silent = [topic for topic in seen.topics if not topic.publishers and topic.fields]
    silent.sort(key=lambda topic: REFERENCE.search(topic.name) is None)
    nothing = not silent and not seen.actions and not calls
    yield f"  # start:{'  # docs/procedure.md lists the steps' if nothing else ''}"
    for topic in silent[:MOST_INPUTS]:
        if (offer := step_of(signal_offers(topic)[0], None)) is not None:
            yield f"  #   - publish: {dump_line(offer.forth)}  # {known(topic)}"
    yield from (f"  #   {line}" for line in (*calls, *_goals(seen.actions)))


def known(topic: SeenTopic) -> str:
    """Return in a sentence what is known of a topic that could carry the reference."""
    who = " and ".join(topic.publishers) or "Nobody"
    heard = " and ".join(dict.fromkeys(topic.listeners)) or "nobody"
    listens = "listen" if len(set(topic.listeners)) > 1 else "listens"
    by_name = (
        "by its name it is the reference"
        if REFERENCE.search(topic.name)
        else "by its name it is the truth"
        if TRUTH.search(topic.name)
        else "whether it is the reference is not known"
    )
    return f"{who} publishes {topic.name}, {heard} {listens} to it; {by_name}."


def published(
    offer: SignalOffer, value: float, beside: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """Return a step's topic and message, in which one field has a value.

    The other joints of a trajectory stay where they are, and so do the fields `beside` it.
    """
    if offer.topic.joints:
        return {"topic": offer.topic.name, "message": _trajectory(offer, value)}
    fields = offer.topic.fields
    message: dict[str, Any] = {}
    for name in fields:
        if name.endswith("orientation.w"):
            # A quaternion of zeros is no rotation.
            _put(message, name, 1.0)
    for name, number in (beside or {}).items():
        _put(message, name, number)
    # With the type of the field: an integer takes no 1.0, and a truth value no number.
    kind = type(fields[offer.field])
    path, is_item, _ = offer.field.partition("[")
    if is_item:
        items = [name for name in fields if name.startswith(f"{path}[")]
        _put(message, path, [kind(value if name == offer.field else 0) for name in items])
    else:
        _put(message, path, kind(value))
    return {"topic": offer.topic.name, "message": message}


def _put(message: dict[str, Any], path: str, value: Any) -> None:
    *parts, last = path.split(".")
    for part in parts:
        message = message.setdefault(part, {})
    message[last] = value


def _trajectory(offer: SignalOffer, value: float) -> dict[str, Any]:
    positions = [
        value if name == offer.field else round(float(now), 2) + 0.0
        for name, now in offer.topic.fields.items()
    ]
    point = {"positions": positions, "time_from_start": {"sec": TRAJECTORY_SECONDS}}
    return {"joint_names": list(offer.topic.joints), "points": [point]}


def _deviation(name: str, rest: float) -> str:
    if rest == 0.0:
        return f"abs({name})"
    return f"abs({name} {'-' if rest > 0 else '+'} {abs(rest):g})"


def _goals(actions: Iterable[SeenAction]) -> Iterator[str]:
    for action in actions:
        fields = ", ".join(f"{name} ({kind})" for name, kind in action.fields.items())
        step = dump_line({"action": action.name, "goal": {}})
        yield f"- send_goal: {step}  # {action.type}: {fields or 'no fields'}"
