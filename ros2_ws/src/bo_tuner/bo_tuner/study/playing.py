"""A bag that is played to the nodes in a run."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated

from rosbags.rosbag2 import Reader
from rosbags.rosbag2.errors import ReaderError

from bo_tuner.codec import checks
from bo_tuner.codec.findings import under
from bo_tuner.codec.reading import Section, read
from bo_tuner.codec.rules import POSITIVE, SECONDS, Alone, Expected, Matching, Whole, Within
from bo_tuner.errors import KeyPath, StudyError
from bo_tuner.study.braces import Values, filled, names_in
from bo_tuner.study.signals import GRAPH_NAME
from bo_tuner.text import one_line

PATTERN = "*?["
"""Characters that make a name one of several."""
MOST_DELAY = 60.0
"""Longest time [s] by which messages of a topic may come late."""

PIECE = re.compile(r"(?P<bag>.+)@(?P<begin>\d+(\.\d+)?)-(?P<end>\d+(\.\d+)?)")
"""A piece of a bag: its times [s] after the name."""

_TOPIC = Matching(GRAPH_NAME, "a topic name such as /imu")


def _topics(by_topic: Mapping[str, object]) -> Mapping[str, object]:
    for name in by_topic:
        _TOPIC(name, name)
    return by_topic


@dataclass(frozen=True)
class _Amount:
    """A number in a range, or the name of a context in braces."""

    within: Within

    def __call__(self, value: object) -> object:
        """Return it."""
        if isinstance(value, str) and list(names_in(value)) and value[:1] + value[-1:] == "{}":
            return value
        return self.within(value)


def _bag(path: str) -> str:
    if not path:
        raise StudyError("expected the folder or file of a bag")
    return path


@dataclass(frozen=True, kw_only=True)
class Answer(Section):
    """A topic on which a node answers the messages of another one.

    Attributes
    ----------
    topic : str
        Topic of the answers.
    every : int
        How many messages it takes for an answer.
    """

    topic: Annotated[str, _TOPIC]
    every: Annotated[int, Whole(1)] = 1

    alone = Alone(str, lambda topic: {"topic": topic}, "a topic such as /odometry")


def in_short(answers: Mapping[str, Answer]) -> dict[str, object]:
    """Return answers as a study file has them."""
    return {
        topic: item.topic if item.every == 1 else {"topic": item.topic, "every": item.every}
        for topic, item in answers.items()
    }


@dataclass(frozen=True, kw_only=True)
class Play(Section):
    """Plays a bag to the nodes, by whose time the run goes.

    In lockstep a message is played once the nodes that hear it are done with the one before, so
    that a run is the same whatever the computer is busy with. A node is done when it answers a
    question on its parameters that comes after the message, or, for a topic in `answers`, when
    its answer is there.

    Attributes
    ----------
    bag : str
        Folder of the bag, or its MCAP or SQLite file, from the folder of the study file; may have
        names of contexts in braces.
    topics : tuple of str
        Topics that are played; all that a node or a signal hears and no node publishes, unless
        given.
    remap : mapping from str to str
        Other names for topics of the bag.
    lockstep : bool
        Whether the nodes are waited for.
    answers : mapping from str to Answer
        Topics on which answers come, by the topic, as it is played, that they answer: for nodes
        that work on messages in threads of their own, or have no parameter services.
    rate : float, optional
        Speed, in seconds of the bag per second. In lockstep as fast as the nodes follow, and 1
        otherwise, unless given.
    begin : float
        Time [s] in the bag to begin at.
    end : float, optional
        Time [s] in the bag to end at; its end unless given.
    delay : mapping from str to float
        Times [s] by which messages of topics come late; may be contexts in braces.
    drop : mapping from str to float
        Shares, 0 to 1, of the messages of topics that are left out, in each run the same ones; may
        be contexts in braces.
    noise : mapping from str to mapping
        Standard deviations of noise that is added to numbers in messages of topics, by the field,
        as in ``{/imu: {angular_velocity.z: 0.01}}``; in each run the same noise. They may be
        contexts in braces.
    timeout : float
        Longest time [s] that a node takes for a message.
    """

    bag: Annotated[str, checks.text, _bag]
    topics: Annotated[tuple[Annotated[str, _TOPIC], ...], Expected("a list of topics")] = ()
    remap: Annotated[Mapping[str, Annotated[str, _TOPIC]], _topics] = field(default_factory=dict)
    lockstep: bool = True
    answers: Annotated[Mapping[str, Answer], _topics] = field(default_factory=dict)
    rate: Annotated[float, POSITIVE] | None = None
    begin: Annotated[float, Within(least=0.0, unit="s")] = 0.0
    end: float | None = None
    delay: Annotated[
        Mapping[str, Annotated[float | str, _Amount(Within(least=0.0, most=MOST_DELAY, unit="s"))]],
        _topics,
    ] = field(default_factory=dict)
    drop: Annotated[
        Mapping[str, Annotated[float | str, _Amount(Within(least=0.0, most=1.0))]], _topics
    ] = field(default_factory=dict)
    noise: Annotated[
        Mapping[
            str,
            Annotated[
                Mapping[str, Annotated[float | str, _Amount(Within(least=0.0))]],
                Expected("standard deviations by field"),
            ],
        ],
        _topics,
    ] = field(default_factory=dict)
    timeout: Annotated[float, SECONDS] = 5.0

    alone = Alone(str, lambda bag: {"bag": bag}, "a bag, or a mapping such as {bag: drive}")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.answers and not self.lockstep:
            raise StudyError("are waited for in lockstep; leave out one of the two", ("answers",))
        if self.end is not None and self.end <= self.begin:
            raise StudyError(f"expected more than begin, {self.begin:g} s", ("end",))

    def filled(self, values: Values) -> "Play":
        """Return it with values for names in braces."""
        keys = ("bag", "delay", "drop", "noise")
        given = {key: filled(getattr(self, key), values) for key in keys}
        if piece := PIECE.fullmatch(given["bag"]):
            given |= {"bag": piece["bag"], "begin": float(piece["begin"])}
            given |= {"end": float(piece["end"])}
        return replace(self, **given)

    @property
    def names_in_braces(self) -> Iterator[tuple[KeyPath, str, bool]]:
        """The names in braces with their places, and whether a number stands there."""
        for name in names_in(self.bag):
            yield ("bag",), name, False
        for key in ("delay", "drop"):
            for topic, amount in getattr(self, key).items():
                for name in names_in(amount):
                    yield (key, topic), name, True
        for topic, amounts in self.noise.items():
            for path, amount in amounts.items():
                for name in names_in(amount):
                    yield ("noise", topic, path), name, True


@dataclass(frozen=True, kw_only=True)
class Bags(Section):
    """The bags of a context: one of them is played in each run.

    It is short for `distribution: discrete` with the bags as its values, which steps have by the
    name of the context in braces.

    Attributes
    ----------
    bags : tuple of str
        Folders or files of bags, from the folder of the study file; with `*` all that are so
        called.
    weights : tuple of float
        How often each comes in operation, relative to the others; equally often unless given.
    split : float, optional
        Length [s] of the pieces into which bags are cut, about: those of one bag are equally long.
        An estimator then begins within a drive. They make no further drives.
    """

    bags: Annotated[tuple[str, ...], Expected("a list of bags")]
    weights: Annotated[tuple[Annotated[float, POSITIVE], ...], Expected("a list of numbers")] = ()
    split: Annotated[float, POSITIVE] | None = None

    def values(self, folder: Path | None) -> dict[str, object]:
        """Return the fields of the discrete distribution; `folder` is that of the study file.

        Raises
        ------
        StudyError
            If there are fewer than two, or not a weight for each bag.
        """
        found: dict[str, None] = {}
        for index, text in enumerate(self.bags):
            for name in _named(text, folder, index):
                if name in found:
                    raise StudyError(f"'{name}' is named twice", ("bags", index))
                found[name] = None
        pieces = {name: self._pieces(name, folder) for name in found}
        values = [piece for each in pieces.values() for piece in each]
        if len(values) < 2:
            raise StudyError(
                f"expected at least two bags, found {len(values)}; a single one is no context: "
                "write it into play",
                ("bags",),
            )
        made: dict[str, object] = {"distribution": "discrete", "values": values}
        if self.weights:
            if len(self.weights) != len(found):
                raise StudyError(
                    f"expected one for each of {len(found)} bags, found {len(self.weights)}",
                    ("weights",),
                )
            total = sum(self.weights)
            made["probabilities"] = [
                weight / total / len(each)
                for weight, each in zip(self.weights, pieces.values(), strict=True)
                for _ in each
            ]
        return made

    def _pieces(self, name: str, folder: Path | None) -> list[str]:
        """Return the pieces of a bag, as `Play` reads them; without `split` the bag itself."""
        if self.split is None:
            return [name]
        seconds = _seconds(Path(folder or "", name))
        count = max(round(seconds / self.split), 1)
        ends = [f"{seconds * k / count:.3f}" for k in range(count + 1)]
        return [f"{name}@{begin}-{end}" for begin, end in pairwise(ends)]


def _seconds(path: Path) -> float:
    """Return the length [s] of a bag."""
    try:
        with Reader(path) as reader:
            return float(reader.duration * 1e-9)
    except (ReaderError, OSError, ValueError) as error:
        raise StudyError(f"'{path}' cannot be read: {one_line(str(error))}", ("bags",)) from None


def _named(text: str, folder: Path | None, index: int) -> list[str]:
    """Return the bags that are so called, in the order of their names."""
    if not set(text) & set(PATTERN):
        return [text]
    if folder is None:
        raise StudyError("expected names: there is no study file", ("bags", index))
    base = Path(text).anchor
    at = Path(base) if base else folder
    paths = sorted(path for path in at.glob(text[len(base) :]) if is_bag(path))
    if not paths:
        raise StudyError(f"no bag in {folder} is called {text}", ("bags", index))
    return [str(path if base else path.relative_to(folder)) for path in paths]


def is_bag(path: Path) -> bool:
    """Whether a path may be a bag."""
    return path.suffix in (".mcap", ".db3") or (path / "metadata.yaml").exists()


def with_bags(mapping: object, folder: Path | None) -> object:
    """Return what a study file says, with its bags written out as values of contexts.

    Raises
    ------
    StudyError
        If they violate a rule.
    """
    contexts = mapping.get("contexts") if isinstance(mapping, dict) else None
    if not isinstance(mapping, dict) or not isinstance(contexts, dict):
        return mapping
    keys = [item.name for item in fields(Bags)]
    written = {}
    for name, item in contexts.items():
        written[name] = item
        if isinstance(item, dict) and "bags" in item:
            with under("contexts", name):
                if "distribution" in item:
                    raise StudyError("stands beside bags; leave it out", ("distribution",))
                bags = read(Bags, {key: item[key] for key in keys if key in item})
                others = {key: value for key, value in item.items() if key not in keys}
                written[name] = others | bags.values(folder)
    return mapping | {"contexts": written}
