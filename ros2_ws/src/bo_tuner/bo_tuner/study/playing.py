"""A bag that is played to the nodes in a run."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from bo_tuner.errors import StudyError
from bo_tuner.study import checks
from bo_tuner.study.braces import names_in
from bo_tuner.study.building import arguments, build, under
from bo_tuner.study.signals import GRAPH_NAME

PATTERN = "*?["
"""Characters that make a name one of several."""
MOST_DELAY = 60.0
"""Longest time [s] by which messages of a topic may come late."""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """A topic on which a node answers the messages of another one.

    Attributes
    ----------
    topic : str
        Topic of the answers.
    every : int
        How many messages it takes for an answer.
    """

    topic: str
    every: int = 1

    def __post_init__(self) -> None:
        checks.matching(self.topic, GRAPH_NAME, "a topic name such as /odometry", "topic")
        checks.integer(self.every, "every", at_least=1)


@dataclass(frozen=True, kw_only=True)
class Play:
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
        Topics that are played; all but those that a node of others publishes, unless given.
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
    timeout : float
        Longest time [s] that a node takes for a message.
    """

    bag: str
    topics: tuple[str, ...] = ()
    remap: Mapping[str, str] = field(default_factory=dict)
    lockstep: bool = True
    answers: Mapping[str, Answer] = field(default_factory=dict)
    rate: float | None = None
    begin: float = 0.0
    end: float | None = None
    delay: Mapping[str, float | str] = field(default_factory=dict)
    drop: Mapping[str, float | str] = field(default_factory=dict)
    timeout: float = 5.0

    def __post_init__(self) -> None:
        checks.text(self.bag, "bag")
        if not self.bag:
            raise StudyError("expected the folder or file of a bag", ("bag",))
        names = checks.sequence(self.topics, "a list of topics", "topics")
        topics = tuple(_topic(name, "topics", k) for k, name in enumerate(names))
        object.__setattr__(self, "topics", topics)
        for key in ("remap", "answers", "delay", "drop"):
            value = getattr(self, key)
            if not isinstance(value, Mapping):
                raise StudyError(f"expected topics, found {checks.show(value)}", (key,))
            for name in value:
                _topic(name, key, str(name))
        for name, other in self.remap.items():
            _topic(other, "remap", name)
        checks.boolean(self.lockstep, "lockstep")
        if self.answers and not self.lockstep:
            raise StudyError("are waited for in lockstep; leave out one of the two", ("answers",))
        if self.rate is not None:
            object.__setattr__(self, "rate", checks.positive(self.rate, "rate"))
        begin = checks.number(self.begin, "begin")
        object.__setattr__(self, "begin", begin)
        if begin < 0.0:
            raise StudyError(f"expected at least 0 s, found {begin:g}", ("begin",))
        if self.end is not None:
            object.__setattr__(self, "end", checks.number(self.end, "end"))
            if self.end <= begin:
                raise StudyError(f"expected more than begin, {begin:g} s", ("end",))
        object.__setattr__(self, "delay", self._amounts("delay", MOST_DELAY))
        object.__setattr__(self, "drop", self._amounts("drop", 1.0))
        object.__setattr__(self, "timeout", checks.timeout(self.timeout, "timeout"))

    def _amounts(self, key: str, most: float) -> dict[str, float | str]:
        """Return the amounts by topic, numbers or a name in braces each."""
        amounts: dict[str, float | str] = {}
        for name, given in getattr(self, key).items():
            if isinstance(given, str) and re.fullmatch(r"\{\w+(\.\w+)*\}", given):
                amounts[name] = given
                continue
            amount = checks.number(given, key, name)
            if not 0.0 <= amount <= most:
                raise StudyError(f"expected 0 to {most:g}, found {amount:g}", (key, name))
            amounts[name] = amount
        return amounts

    @property
    def varies(self) -> Iterator[str]:
        """Names in braces that the bag depends on."""
        return names_in(self.bag)


def _topic(name: object, *path: str | int) -> str:
    return checks.matching(name, GRAPH_NAME, "a topic name such as /imu", *path)


@dataclass(frozen=True, kw_only=True)
class Bags:
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
    """

    bags: tuple[str, ...]
    weights: tuple[float, ...] = ()

    def values(self, folder: Path | None) -> dict[str, object]:
        """Return the fields of the discrete distribution; `folder` is that of the study file.

        Raises
        ------
        StudyError
            If there are fewer than two bags, or not a weight for each.
        """
        patterns = checks.sequence(self.bags, "a list of bags", "bags")
        found: dict[str, None] = {}
        for index, pattern in enumerate(patterns):
            text = checks.text(pattern, "bags", index)
            names = [text]
            if set(text) & set(PATTERN):
                if folder is None:
                    raise StudyError("expected names: there is no study file", ("bags", index))
                base = Path(text).anchor
                at = Path(base) if base else folder
                paths = sorted(path for path in at.glob(text[len(base) :]) if is_bag(path))
                names = [str(path if base else path.relative_to(folder)) for path in paths]
                if not names:
                    raise StudyError(f"no bag in {folder} is called {text}", ("bags", index))
            for name in names:
                if name in found:
                    raise StudyError(f"'{name}' is named twice", ("bags", index))
                found[name] = None
        if len(found) < 2:
            raise StudyError(
                f"expected at least two bags, found {len(found)}; a single one is no context: "
                "write it into play",
                ("bags",),
            )
        made: dict[str, object] = {"distribution": "discrete", "values": list(found)}
        weights = checks.sequence(self.weights, "a list of numbers", "weights")
        if weights:
            given = [checks.positive(item, "weights", index) for index, item in enumerate(weights)]
            if len(given) != len(found):
                raise StudyError(
                    f"expected one for each of {len(found)} bags, found {len(given)}", ("weights",)
                )
            made["probabilities"] = [weight / sum(given) for weight in given]
        return made


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
    written = {}
    for name, item in contexts.items():
        written[name] = item
        if isinstance(item, dict) and "bags" in item:
            keys = [each.name for each in fields(Bags)]
            with under("contexts", name):
                if "distribution" in item:
                    raise StudyError("stands beside bags; leave it out", ("distribution",))
                bags = build(Bags, {key: item[key] for key in keys if key in item})
                others = {key: value for key, value in item.items() if key not in keys}
                written[name] = others | bags.values(folder)
    return mapping | {"contexts": written}


def build_play(value: object) -> Play:
    """Return what a step of a study file plays; a text is the bag, played as it is.

    Raises
    ------
    StudyError
        If it violates a rule.
    """
    if isinstance(value, str):
        return Play(bag=value)
    given: dict[str, Any] = arguments(Play, value)
    answers = given.get("answers")
    if isinstance(answers, Mapping):
        made = {}
        for name, item in answers.items():
            with under("answers", str(name)):
                made[name] = Answer(topic=item) if isinstance(item, str) else build(Answer, item)
        given["answers"] = made
    return Play(**given)
