"""What a step of a run publishes: a message, once, or a reference that streams."""

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Self

import numpy as np

from bo_tuner import maxima
from bo_tuner.codec import checks
from bo_tuner.codec.findings import under
from bo_tuner.codec.reading import Section
from bo_tuner.codec.rules import SECONDS, AtMost, Expected, Matching, Within
from bo_tuner.errors import KeyPath, StudyError
from bo_tuner.study.braces import Values, filled, names_in
from bo_tuner.study.fields import field_path
from bo_tuner.study.profiles import Profile, StepProfile
from bo_tuner.study.signals import GRAPH_NAME, MESSAGE_TYPE, OF_MESSAGES

WATCHDOG = 0.1
"""Time [s] without a message after which many drivers stop a machine."""
CHECKED = 60.0
"""Time [s] over which values of a profile are checked before the first run; later ones are not."""


def check_message(value: Any, *path: str | int) -> Any:
    """Return the fields of a message; refuse what no message can hold."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            if not isinstance(item, (bool, int, float, str)):
                check_message(item, *path, checks.text(key, *path))
    elif isinstance(value, (list, tuple)) and path:
        for index, item in enumerate(value):
            if not isinstance(item, (bool, int, float, str)):
                check_message(item, *path, index)
    else:
        raise StudyError(f"expected the fields of a message, found {checks.show(value)}", path)
    return value


Message = Annotated[Mapping[str, object], Expected("the fields of a message"), check_message]


@dataclass(frozen=True, kw_only=True)
class Topic(Section):
    """A topic that a step publishes.

    Attributes
    ----------
    topic : str
        Topic.
    message : mapping
        Fields of the message by name; those that are left out are zero. A header without a stamp
        gets the present time.
    type : str
        Type of the message; that of the topic's subscribers unless given.
    profile : mapping from str to Profile
        Of a stream, numbers over time by their field, such as `data`, `twist.linear.x` or
        `points[0].positions[1]`; an array is as long as they need it.
    follow : mapping from str to str
        Signals by the field of `profile` that they are to follow: a run fails in which the signal
        moves by less than a twentieth of what the field does.
    """

    topic: Annotated[str, Matching(GRAPH_NAME, "a topic name such as /setpoint")]
    message: Message = field(default_factory=dict)
    type: Annotated[str, Matching(MESSAGE_TYPE, OF_MESSAGES)] = ""
    profile: Annotated[Mapping[str, Profile], Expected('fields such as {data: "sin(t)"}')] = field(
        default_factory=dict
    )
    follow: Annotated[Mapping[str, str], Expected("fields such as {data: angle}")] = field(
        default_factory=dict
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.profile:
            with under("profile", name):
                try:
                    field_path(name)
                except StudyError as error:
                    raise StudyError(error.problem) from None
        for name in self.follow:
            checks.reference(name, "field in profile", self.profile, "follow")

    def filled(self, values: Values) -> Self:
        """Return it with values for names in braces."""
        profile = {name: item.filled(values) for name, item in self.profile.items()}
        return dataclasses.replace(self, message=filled(self.message, values), profile=profile)

    @property
    def names_in_braces(self) -> Iterator[tuple[KeyPath, str, bool]]:
        """Names of contexts and parameters in braces, with key paths; whether in an expression."""
        for name in names_in(self.message):
            yield ("message",), name, False
        for field_name, item in self.profile.items():
            for name in names_in(item.expression):
                yield ("profile", field_name), name, True


@dataclass(frozen=True, kw_only=True)
class Publish(Topic):
    """A message that is published once, or, with a `rate`, a reference that streams.

    Attributes
    ----------
    profile : mapping from str to Profile
        Of a stream, numbers over time by their field, such as `data`, `twist.linear.x` or
        `points[0].positions[1]`; an array is as long as they need it. Without any, the same
        message again and again.
    rate : float, optional
        Messages in a second: it streams from this step on, while later ones are performed.
    duration : float, optional
        Time [s] after which a stream ends; with the run unless given.
    largest_gap : float, optional
        Longest time [s] between two messages of a stream; three periods, but at least 0.1, unless
        given. A run with a longer one does not count.
    topics : tuple of Topic
        Several topics that stream in step, instead of one.
    """

    topic: Annotated[str, Matching(GRAPH_NAME, "a topic name such as /setpoint")] = ""
    rate: Annotated[float, Within(above=0.0, most=maxima.STREAM_RATE, unit="Hz")] | None = None
    duration: Annotated[float, SECONDS] | None = None
    largest_gap: Annotated[float, SECONDS] | None = None
    topics: Annotated[
        tuple[Topic, ...], Expected("a list of topics"), AtMost(maxima.STREAM_TOPICS)
    ] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.topics:
            own = [f.name for f in dataclasses.fields(Topic) if getattr(self, f.name)]
            if own:
                raise StudyError("stands beside topics; expected it in each of these", (own[0],))
        elif self.topic == "":
            raise StudyError("missing", ("topic",))
        if self.rate is None:
            for key in ("profile", "duration", "largest_gap", "follow", "topics"):
                if getattr(self, key):
                    raise StudyError(f"missing; expected how often, for {key}", ("rate",))
        names = [item.topic.strip("/") for item in self.published]
        for index, name in enumerate(names):
            if name in names[:index]:
                raise StudyError(f"{name} stands here twice", ("topics", index, "topic"))
        if self.rate is not None:
            self._check_stream(self.rate)

    def _check_stream(self, rate: float) -> None:
        if self.largest_gap is not None and self.largest_gap <= 1.0 / rate:
            raise StudyError(
                f"{self.largest_gap:g} s are no more than a period of {1.0 / rate:g} s",
                ("largest_gap",),
            )
        for path, profile in self.profiles:
            # Nyquist: a faster sine would appear as a slower one.
            if profile.highest_frequency >= rate / 2.0:
                raise StudyError(
                    f"{profile.highest_frequency:g} Hz cannot be seen in {rate:g} messages a "
                    f"second; expected a rate above {2.0 * profile.highest_frequency:g}",
                    path,
                )

    @property
    def published(self) -> tuple[Topic, ...]:
        """The topics that it publishes."""
        if self.topics:
            return self.topics
        return (Topic(**{f.name: getattr(self, f.name) for f in dataclasses.fields(Topic)}),)

    def filled(self, values: Values) -> Self:
        """Return it with values for names in braces, in each of its topics."""
        topics = tuple(topic.filled(values) for topic in self.topics)
        return dataclasses.replace(super().filled(values), topics=topics)

    @property
    def names_in_braces(self) -> Iterator[tuple[KeyPath, str, bool]]:
        """Names of contexts and parameters in braces, with key paths; whether in an expression."""
        for path, topic in zip(self.paths, self.published, strict=True):
            own = topic.names_in_braces
            yield from (((*path, *below), name, is_number) for below, name, is_number in own)

    @property
    def paths(self) -> list[tuple[str | int, ...]]:
        """Key path of each of `published`, from this step."""
        return [("topics", i) for i in range(len(self.topics))] or [()]

    @property
    def profiles(self) -> Iterator[tuple[tuple[str | int, ...], Profile]]:
        """Its profiles, each with its key path."""
        for path, topic in zip(self.paths, self.published, strict=True):
            for name, profile in topic.profile.items():
                yield (*path, "profile", name), profile

    @property
    def streams(self) -> bool:
        """Whether it publishes more than once."""
        return self.rate is not None

    @property
    def gap(self) -> float:
        """Longest time [s] between two messages of a stream."""
        return self.largest_gap or max(WATCHDOG, 3.0 / (self.rate or 1.0))

    def ending(self, folder: str) -> tuple[Topic, ...]:
        """Return its last messages: of a stream, those with the values of its profiles at its end.

        Raises
        ------
        StudyError
            If a file of a profile is not as it should be.
        """
        end = np.array([self.duration or 0.0])

        def constant(profile: Profile) -> Profile:
            return Profile(step=StepProfile(final=float(profile.function(folder)(end)[0])))

        return tuple(
            dataclasses.replace(
                topic, profile={name: constant(item) for name, item in topic.profile.items()}
            )
            for topic in self.published
        )

    def read_files(self, folder: str, longest: float) -> "Publish":
        """Return it with the digests of its files, after a check of these and of its values.

        Parameters
        ----------
        folder
            The study's.
        longest
            Time [s] up to which values are checked.

        Raises
        ------
        StudyError
            If a file is not as it should be, or an expression is not finite.
        """
        topics = []
        for path, topic in zip(self.paths, self.published, strict=True):
            profile = dict(topic.profile)
            for name, item in topic.profile.items():
                with under(*path, "profile", name):
                    profile[name] = item.read_files(folder)
                    self._check_finite(item, folder, longest)
            topics.append(dataclasses.replace(topic, profile=profile))
        if self.topics:
            return dataclasses.replace(self, topics=tuple(topics))
        return dataclasses.replace(self, profile=topics[0].profile)

    def _check_finite(self, profile: Profile, folder: str, longest: float) -> None:
        if any(names_in(profile.expression)):
            # What it comes to is known with the values alone.
            return
        rate = self.rate or 1.0
        count = int(min(self.duration or longest, longest, CHECKED) * rate) + 1
        times = np.arange(count) / rate
        values = profile.function(folder)(times)
        if len(wrong := np.flatnonzero(~np.isfinite(values))):
            raise StudyError(
                f"is {values[wrong[0]]:g} at {times[wrong[0]]:g} s; expected a finite number"
            )
