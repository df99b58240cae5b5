"""A first study for an estimator that hears a bag, as a text with comments.

What is the truth, and what is its estimate, can only be guessed by names and types.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from bo_tuner.study.first_study import heading, node_keys, node_line, parameter_lines
from bo_tuner.study.offers import CHECK, ParameterOffer
from bo_tuner.study.parameter import array_and_item
from bo_tuner.study.playing import Answer, in_short
from bo_tuner.study.seen import SeenNode, SeenTopic
from bo_tuner.study.signal_offers import TRUTH, UNUSUAL
from bo_tuner.study.sizing import OF_PARAMETER, first_budget
from bo_tuner.study.strict_yaml import dump_line
from bo_tuner.text import listed

REFERENCE_SYSTEM = re.compile(
    r"vicon|optitrack|mocap|motion_?capture|vrpn|qualisys|leica|total_?station"
    r"|(^|[/_])(reference|ref|rtk)([/_]|$)",
    re.IGNORECASE,
)
"""Words in the name of a topic of what measures better than the sensors that a node hears."""
INNOVATION = re.compile(r"innovation|residual", re.IGNORECASE)
"""Words in the name of a topic with what a filter did not expect of its measurements."""
IN_ELLIPSE = 5.99
"""Limit of the squared distance in units of the covariance, of two coordinates, for 95 %."""
CONSISTENT = 0.85
"""Share of the time in that ellipse, until the user gives a better one."""
AXES = re.compile(r"(^|[_.])(v|a|vel_|acc_|pos_)?(y|pitch)(?=[_.]|$)")
"""A name that is that of a second axis."""
FIRST_AXIS = {"y": "x", "pitch": "roll"}


class Pose(NamedTuple):
    """Where a type of message has a position, an orientation and the covariance of the former."""

    position: str = ""
    orientation: str = ""
    covariance: str = ""


POSES = {
    "nav_msgs/msg/Odometry": Pose("pose.pose.position", "pose.pose.orientation", "pose.covariance"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": Pose(
        "pose.pose.position", "pose.pose.orientation", "pose.covariance"
    ),
    "geometry_msgs/msg/PoseStamped": Pose("pose.position", "pose.orientation"),
    "geometry_msgs/msg/Pose": Pose("position", "orientation"),
    "geometry_msgs/msg/TransformStamped": Pose("transform.translation", "transform.rotation"),
    "geometry_msgs/msg/PointStamped": Pose("point"),
    "geometry_msgs/msg/QuaternionStamped": Pose("", "quaternion"),
    "sensor_msgs/msg/Imu": Pose("", "orientation"),
}


@dataclass(frozen=True)
class HeardBag:
    """What running nodes hear of a bag, and what they answer.

    Attributes
    ----------
    topics
        Topics of the bag, with the numbers of their first messages, and the nodes that hear them.
    outputs
        What these nodes publish, with the numbers of the latest message.
    answers
        Topics on which messages are answered, by the topic that they are on.
    """

    topics: tuple[SeenTopic, ...]
    outputs: tuple[SeenTopic, ...]
    answers: Mapping[str, Answer] = field(default_factory=dict, hash=False)

    @property
    def heard(self) -> tuple[SeenTopic, ...]:
        """The topics that a node hears."""
        return tuple(topic for topic in self.topics if topic.listeners)


@dataclass(frozen=True)
class Task:
    """What is compared: an estimate, and the truth, if there is one, with how it is known."""

    estimate: SeenTopic
    truth: SeenTopic | None = None
    known_by: str = ""

    @property
    def pose(self) -> tuple[Pose, Pose]:
        """Where both have a pose, as far as they have it both."""
        of_truth = POSES.get(self.truth.type if self.truth else "", Pose())
        of_estimate = POSES.get(self.estimate.type, Pose())
        has = [bool(a and b) for a, b in zip(of_truth, of_estimate, strict=True)]
        place, turn = has[0], has[1] and (not has[0] or self._turns)
        truth = Pose(of_truth[0] * place, of_truth[1] * turn)
        return truth, Pose(of_estimate[0] * place, of_estimate[1] * turn, of_estimate[2] * place)

    @property
    def _turns(self) -> bool:
        """Whether both have an orientation: of a position alone it is that of an empty message."""
        return all(
            topic is not None
            and any(topic.fields.get(f"{POSES[topic.type].orientation}.{axis}") for axis in "xyz")
            for topic in (self.truth, self.estimate)
        )


def task_of(bag: HeardBag, named: Sequence[str] = ()) -> Task | None:
    """Return what to compare; None if the nodes publish nothing.

    Parameters
    ----------
    bag
        What the nodes hear of a bag, and answer.
    named
        Topics to choose of, if any.
    """
    outputs = [topic for topic in bag.outputs if topic.name in named] or list(bag.outputs)
    outputs = [topic for topic in outputs if topic.fields]
    others = [topic for topic in bag.topics if topic.fields and topic.name not in _names(outputs)]
    truths: list[tuple[SeenTopic, str]] = [(t, "named") for t in others if t.name in named]
    if not truths:
        free = [topic for topic in others if not topic.listeners]
        truths = [(t, "by its name") for t in free if _is_truth(t.name)]
        poses = [topic for topic in free if topic.type in POSES]
        if not truths and len(poses) == 1:
            truths = [(poses[0], f"{CHECK}: the only pose in the bag that no node hears")]
    pairs = [
        (task, rank)
        for truth, known_by in truths
        for output in outputs
        if (rank := _likeness(task := Task(output, truth, known_by)))
    ]
    if pairs:
        return max(pairs, key=lambda pair: pair[1])[0]
    # The likelihood of innovations needs no truth.
    outputs.sort(key=lambda topic: INNOVATION.search(topic.name) is None)
    return Task(outputs[0]) if outputs else None


def _names(topics: Sequence[SeenTopic]) -> list[str]:
    return [topic.name for topic in topics]


def _is_truth(name: str) -> bool:
    return bool(TRUTH.search(name) or REFERENCE_SYSTEM.search(name))


def _likeness(task: Task) -> int:
    """Return how much two topics have in common: 0 for nothing."""
    truth, estimate = task.pose
    if estimate.position:
        return 4 + bool(estimate.covariance) + bool(estimate.orientation)
    return 3 if truth.orientation else 2 if _common(task) else 0


def _common(task: Task) -> str:
    """Return the first number that both messages have; empty if there is none."""
    fields = () if task.truth is None else task.truth.fields
    both = [name for name in task.estimate.fields if name in fields and not UNUSUAL.search(name)]
    return next(iter(both), "")


def tied(taken: Sequence[ParameterOffer]) -> dict[ParameterOffer, ParameterOffer]:
    """Return which parameters follow another one: variances of x and y with the same value.

    A covariance has rows for x, y, z, roll, pitch, yaw and so on; scalars are told by their names.
    """
    known = {(offer.node, offer.name): offer for offer in taken}
    ties = {}
    for offer in taken:
        other = known.get((offer.node, _first_axis(offer, taken)))
        if other is not None and other.fields["default"] == offer.fields["default"]:
            ties[offer] = other
    return ties


def _first_axis(offer: ParameterOffer, taken: Sequence[ParameterOffer]) -> str:
    """Return the name of the same number of the first axis; empty if it is not of the second."""
    array, item = array_and_item(offer.name)
    if not array:
        match = AXES.search(offer.name)
        if match is None:
            return ""
        begin, end = match.span(3)
        return offer.name[:begin] + FIRST_AXIS[match[3]] + offer.name[end:]
    items = sorted(
        array_and_item(o.name)[1]
        for o in taken
        if o.node == offer.node and array_and_item(o.name)[0] == array
    )
    step = items[1] - items[0] if len(items) > 1 else 0
    # A matrix of 2 rows has x and y alone; otherwise they come by threes.
    is_second = step > 1 and (item == step if step == 3 else item // step % 3 == 1)
    return f"{array}[{item - step}]" if is_second else ""


def first_estimator(
    source: str,
    bags: Sequence[str],
    bag: HeardBag,
    task: Task,
    nodes: Sequence[SeenNode],
    parameters: Sequence[ParameterOffer],
    ros_arguments: Sequence[str] = (),
) -> str:
    """Write a study.

    Parameters
    ----------
    source
        Name of its file.
    bags
        Bags as seen from its folder.
    bag
        What the nodes hear of one, and answer.
    task
        What is compared.
    nodes
        Those to tune; of these only the ones with a parameter that is taken are written.
    parameters
        Those to take, at least one.
    ros_arguments
        ``--ros-args`` of the commands that follow.

    Returns
    -------
    str
        YAML that `bo_tuner.study.study_file.parse_study` reads.
    """
    used = [node for node in nodes if any(offer.node == node.name for offer in parameters)]
    keys = node_keys(nodes)
    ties = tied(parameters)
    signals = _signals(task)
    attach = () if all(node.command for node in used) else ("--attach",)
    budget = first_budget(
        len(parameters) - len(ties), contexts=len(bags) > 1, limits_runs="pxx" in signals
    )
    return "\n".join(
        [
            *heading(source, "a bag and the nodes that have heard it", attach, ros_arguments),
            "",
            "nodes:",
            *(node_line(keys[node.name], node, parameters) for node in used),
            "",
            "# `check` tries which move a metric.",
            "parameters:",
            *parameter_lines(nodes, parameters, keys, ties),
            "",
            *_context_lines(bags),
            *_signal_lines(bag, task, signals),
            "",
            *_run_lines(bags, bag, used, keys),
            "",
            *_metric_lines(task, signals, several=len(bags) > 1),
            "",
            f"# {OF_PARAMETER} trials for each parameter, and {OF_PARAMETER} more.",
            f"budget: {dump_line(budget)}",
            "",
        ]
    )


def _context_lines(bags: Sequence[str]) -> Iterator[str]:
    if len(bags) > 1:
        yield "contexts:"
        yield f"  drive: {dump_line({'bags': list(bags)})}"
    else:
        yield f"# {CHECK}: one drive says little of others. With more of them the worst one counts:"
        yield "# contexts:"
        yield f'#   drive: {dump_line({"bags": [*bags, "..."]})}  # and play: "{{drive}}"'
    yield ""


def _signals(task: Task) -> dict[str, tuple[SeenTopic, str]]:
    """Return topic and field of each signal: the truth first."""
    truth, estimate = task.pose
    pairs: list[tuple[str, str, str]] = []
    if estimate.position:
        deep = task.estimate.fields.get(f"{estimate.position}.z")
        axes = "xyz" if deep else "xy"
        at = truth.position, estimate.position
        pairs += [(axis, f"{at[0]}.{axis}", f"{at[1]}.{axis}") for axis in axes]
    if estimate.orientation:
        angles = ("yaw",) if estimate.position else ("roll", "pitch")
        pairs += [
            (angle, f"{angle}({truth.orientation})", f"{angle}({estimate.orientation})")
            for angle in angles
        ]
    if task.truth is not None and not pairs:
        pairs = [("estimate", _common(task), _common(task))]
    signals = {}
    if task.truth is not None:
        signals = {_of_truth(name): (task.truth, own) for name, own, _ in pairs}
    if not pairs:
        fields = [name for name in task.estimate.fields if not UNUSUAL.search(name)]
        pairs = [("estimate", "", (fields or list(task.estimate.fields))[0])]
    signals |= {name: (task.estimate, own) for name, _, own in pairs}
    if _has_covariance(task) and "z" not in signals:
        places = {"pxx": 0, "pxy": 1, "pyy": 7}
        signals |= {
            name: (task.estimate, f"{estimate.covariance}[{place}]")
            for name, place in places.items()
        }
    return signals


def _of_truth(name: str) -> str:
    return "truth" if name == "estimate" else f"true_{name}"


def _has_covariance(task: Task) -> bool:
    """Whether the latest estimate has a covariance."""
    covariance = task.pose[1].covariance
    return bool(covariance and task.estimate.fields.get(f"{covariance}[0]"))


def _signal_lines(
    bag: HeardBag, task: Task, signals: Mapping[str, tuple[SeenTopic, str]]
) -> Iterator[str]:
    if task.truth is not None:
        yield f"# {task.truth.name} is taken for the truth: {task.known_by}."
    yield "signals:"
    for name, (topic, path) in signals.items():
        yield f"  {name}: {dump_line({'topic': topic.name, 'field': path})}  # {topic.type}"
    used = {topic.name for topic, _ in signals.values()}
    left = [t for t in (*bag.topics, *bag.outputs) if t.name not in used and t.fields]
    if left:
        yield f"  # There are also {listed([f'{topic.name} ({topic.type})' for topic in left])}."


def _run_lines(
    bags: Sequence[str], bag: HeardBag, nodes: Sequence[SeenNode], keys: Mapping[str, str]
) -> Iterator[str]:
    yield "run:"
    yield "  clock: sim  # the time of the bag"
    if all(node.command for node in nodes):
        yield "  before:  # an estimator remembers"
        yield from (f"    - restart: {keys[node.name]}" for node in nodes)
    else:
        yield f"  # {CHECK}: an estimator remembers; each run has to find it new. Say how it starts"
        yield "  # (command, at_start: true in nodes), run without --attach, and restart it here."
        yield f"  # before: [{{restart: {keys[nodes[0].name]}}}]"
    hearing = listed(list(dict.fromkeys(n for topic in bag.heard for n in topic.listeners)))
    yield "  start:"
    yield f"    # {hearing} heard {listed(_names(bag.heard))}."
    yield f"    - play: {dump_line('{drive}' if len(bags) > 1 else bags[0])}"
    if bag.answers:
        yield "    # A node with several threads cannot be asked when it is done. For such a one:"
        yield f"    # play: {{bag: BAG, answers: {dump_line(in_short(bag.answers))}}}"
    yield "  end: played"


def _metric_lines(
    task: Task, signals: Mapping[str, tuple[SeenTopic, str]], *, several: bool
) -> Iterator[str]:
    metrics, offers = _metrics(task, signals)
    yield from _remarks(task)
    yield "metrics:"
    yield from (f"  {name}: {dump_line(entry)}" for name, entry in metrics.items())
    yield from (f"  # {name}: {dump_line(entry)}" for name, entry in offers.items())
    yield ""
    yield f"objective: {{metric: {next(iter(metrics))}}}"
    if "consistent" in metrics:
        kind = {"kind": "worst_case"} if several else {"kind": "chance", "probability": 0.9}
        limit = {**kind, "metric": "consistent", "lower": CONSISTENT}
        yield f"constraints:  # {CHECK}: `check` shows what the present parameters reach."
        yield f"  consistency: {dump_line(limit)}"


def _remarks(task: Task) -> Iterator[str]:
    if task.truth is not None:
        yield f"# {CHECK}: what good means. A truth in another frame than the estimate, as of an"
        yield "# odometry, takes truth, estimate and align: true."
        return
    yield f"# {CHECK}: no topic of the bag is a truth by its name and type. If there is one, name"
    yield "# it by --signals, or have a smoother write one into the bag. Otherwise let the node"
    yield "# publish its innovation nu and the variance s of that; what all sensors have in common"
    yield "# stays unseen. How smooth an estimate is says nothing of its error."


def _metrics(
    task: Task, signals: Mapping[str, tuple[SeenTopic, str]]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return metrics, the objective first, and others that are offered."""
    if task.truth is None:
        of = "estimate"
        offers = {
            "likelihood": {"of": "log(s) + nu * nu / s", "measure": "mean"},
            "consistent": {"of": "nu * nu / s < 3.84", "measure": "mean", "range": [0.0, 1.0]},
        }
        if INNOVATION.search(task.estimate.name):
            return {"innovation": {"of": of, "measure": "rms"}}, offers
        return {"roughness": {"of": of, "measure": "total_variation_rate"}}, offers
    if "x" not in signals and "roll" not in signals:
        return {"error": {"of": "truth - estimate", "measure": "rms"}}, {}
    if "roll" in signals:
        of = "hypot(true_roll - roll, true_pitch - pitch)"
        return {"error": {"of": of, "measure": "rms", "unit": "rad"}}, {}
    axes = [axis for axis in "xyz" if axis in signals]
    compared = {"truth": [f"true_{axis}" for axis in axes], "estimate": axes}
    metrics: dict[str, Any] = {"error": {**compared, "measure": "rms"}}
    offers = {}
    if "yaw" in signals:
        of = "abs(atan2(sin(true_yaw - yaw), cos(true_yaw - yaw)))"
        metrics["yaw_error"] = {"of": of, "measure": "rms", "unit": "rad"}
        drift = {**compared, "over": 5.0, "yaw": ["true_yaw", "yaw"], "measure": "rms"}
        offers = {"drift": drift} if len(axes) == 2 else {}
    if "pxx" in signals:
        # Share of the time in which the error lies in the ellipse that is to hold 95 % of all.
        of = (
            "((true_x - x) * (true_x - x) * pyy - 2 * (true_x - x) * (true_y - y) * pxy "
            "+ (true_y - y) * (true_y - y) * pxx) / (pxx * pyy - pxy * pxy) "
            f"< {IN_ELLIPSE}"
        )
        metrics["consistent"] = {"of": of, "measure": "mean", "range": [0.0, 1.0]}
    return metrics, offers
